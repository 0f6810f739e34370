"""The main job in the smallest size: train, carry the checkpoint elsewhere, evaluate there, get the same numbers."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from tests.commands.in_process import call
from tests.commands.test_train import run, tiny


def evaluate(folder: Path, *arguments: str) -> dict[str, Any]:
    quick = ("evaluation.duration=1.5", "evaluation.placements=1", "logger.enabled=false")
    done = call(folder, "evaluate.py", *arguments, *quick)
    assert done.returncode == 0, done.stderr
    assert "metrics.json" in done.stdout
    document: dict[str, Any] = json.loads(next(folder.rglob("metrics.json")).read_text())
    return document


def test_a_copied_checkpoint_evaluates_to_the_same_numbers(tmp_path: Path) -> None:
    trained = run(tmp_path, *tiny("~logger.wandb"))
    assert trained.returncode == 0, trained.stderr
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        shutil.copy(tmp_path / "runs/quickstart/last.ckpt", folder / "model.ckpt")
    first = evaluate(here, "ckpt=model.ckpt", "evaluation.only=[column_0.8]")
    second = evaluate(there, "ckpt=model.ckpt", "evaluation.figures=false")
    assert (here / "evaluation/column_0.8.gif").stat().st_size > 1000
    assert list(second["scenes"]) == ["column_0.8", "column_2.0"]
    for key in ("reference", "learned", "no_motion", "errors"):
        assert first["scenes"]["column_0.8"][key] == second["scenes"]["column_0.8"][key]
    assert first["scenes"]["column_0.8"]["learned"]["penetration_max"] <= 0.5
