"""What a run leaves when it ends: summary, learning curve, figures of rollouts."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from omegaconf import open_dict
from PIL import Image

from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.text import override
from gns_pl.training.history import History, read_history
from gns_pl.training.resume import find_resume
from gns_pl.training.run_summary import best_validation
from gns_pl.training.summary import described, read_summary, summary_lines
from gns_pl.training.train import train
from tests.training import fake_logger
from tests.training.conftest import make_config


def with_images(cfg: Any) -> Any:
    with open_dict(cfg):
        cfg.logger.fake = {"_target_": "tests.training.fake_logger.FakeLogger"}
    fake_logger.LOGGED.clear()
    return cfg


def validations(run: Path) -> list[dict[str, str]]:
    with next((run / "csv").glob("*/metrics.csv")).open() as file:
        return [row for row in csv.DictReader(file) if row["valid/position_error"]]


def test_the_summary_says_what_the_run_was(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "run"
    train(make_config(data_root, run, "description=a test"), run, None)
    summary = read_summary(run)
    assert summary is not None
    assert summary["status"] == "finished" and (summary["steps"], summary["num_steps"]) == (6, 6)
    assert summary["description"] == "a test" and summary["num_starts"] == 1
    # two training trajectories of 11 frames, so of 10 windows; 9 of these 20 lie before the largest kinetic energy and
    # are listed three times
    assert summary["data"] == {"name": "quickstart", "num_train": 2, "num_valid": 1, "num_windows": 2 * 10 + 2 * 9}
    weights = load_checkpoint(run / "last.ckpt").simulator.parameters()
    assert summary["num_parameters"] == sum(weight.numel() for weight in weights)
    assert summary["num_threads"] == torch.get_num_threads()
    logged = validations(run)
    errors = [float(row["valid/position_error"]) for row in logged]
    best = int(np.argmin(errors))
    assert summary["best"]["position_error"] == errors[best] and summary["best"]["step"] == (3, 6)[best]
    assert summary["final"]["runout_99_error"] == float(logged[1]["valid/runout_99_error"])
    assert 0 < summary["step_seconds"] < summary["wall_seconds"] and summary["rollout_step_seconds"] > 0
    assert summary["wall_seconds"] >= 3600 * float(logged[1]["hours"]) > 0
    printed = capsys.readouterr().out
    assert "python evaluate.py ckpt=run/best.ckpt" in printed and "6 of 6 steps" in printed
    assert "step 3 of 6" in printed and "step 6 of 6: position error" in printed


def test_a_resumed_run_is_one_run(data_root: Path, tmp_path: Path) -> None:
    """Its clock goes on where the checkpoint was written, and its figure and summary are of all the steps."""
    cut = make_config(data_root, tmp_path, "trainer.max_steps=4", "logger.csv.version=1")
    train(cut, tmp_path, None)
    first = read_summary(tmp_path)
    assert first is not None and first["status"] == "stopped" and first["steps"] == 4
    saved = torch.load(tmp_path / "last.ckpt", weights_only=True)["callbacks"]["Clock"]["seconds"]
    train(make_config(data_root, tmp_path, "logger.csv.version=2"), tmp_path, find_resume("auto", tmp_path))
    second = read_summary(tmp_path)
    assert second is not None and second["num_starts"] == 2 and second["status"] == "finished"
    history = read_history(tmp_path)
    np.testing.assert_array_equal(history.training["step"], [1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(history.validation["step"], [3, 6])
    hours = history.training["hours"]
    assert (np.diff(hours) > 0).all() and hours[4] * 3600 > saved > hours[2] * 3600
    assert second["wall_seconds"] > saved + second["step_seconds"]
    with Image.open(tmp_path / "learning_curve.png") as image:
        assert image.size[0] > 1000  # steps and time side by side


def test_loggers_that_take_images_get_a_rollout_and_the_learning_curve(data_root: Path, tmp_path: Path) -> None:
    train(with_images(make_config(data_root, tmp_path)), tmp_path, None)
    keys = [(key, step) for key, step, _ in fake_logger.LOGGED]
    rollouts = [(f"rollout/{name}", step) for step in (3, 6) for name in ("curves", "deposit")]
    assert keys == [*rollouts, ("learning_curve", 6)]
    assert all(content.startswith(b"\x89PNG") for _, _, content in fake_logger.LOGGED)
    assert fake_logger.LOGGED[-1][2] == (tmp_path / "learning_curve.png").read_bytes()


def test_without_matplotlib_a_run_still_ends_well(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("run_summary", "rollout_figure"):
        monkeypatch.setattr(f"gns_pl.training.{module}.missing_packages", lambda: ["matplotlib"])
    train(with_images(make_config(data_root, tmp_path)), tmp_path, None)
    assert fake_logger.LOGGED == [] and not (tmp_path / "learning_curve.png").exists()
    assert read_summary(tmp_path) is not None and "pip install 'gns_pl[viz]'" in capsys.readouterr().out


def test_rollouts_that_all_failed_have_no_best() -> None:
    nothing = np.array([])
    step = {"step": np.array([3.0])}
    assert best_validation(History({"step": nothing}, {"step": nothing}, 1)) is None
    assert best_validation(History(step, step | {"position_error": np.array([np.nan])}, 1)) is None
    assert best_validation(History(step, step | {"position_error": np.array([np.nan, 2.0, 1.0])}, 1)) == 2


def test_a_summary_of_a_run_without_a_validation_can_be_told() -> None:
    summary = {
        "name": "cut", "status": "stopped", "steps": 7, "num_steps": 90, "num_starts": 1, "wall_seconds": None,
        "data": {"name": "few", "num_windows": 5, "num_train": 1, "num_valid": 1}, "num_parameters": 3,
        "num_threads": 2, "device": "cpu", "step_seconds": None, "windows_per_s": None, "rollout_step_seconds": None,
        "best": None, "final": None, "checkpoint": "/elsewhere/a b/last.ckpt",
    }  # fmt: skip
    text = "\n".join(summary_lines(summary))
    assert "7 of 90 steps" in text and "not measured" in text
    assert f"python evaluate.py {override('ckpt', '/elsewhere/a b/last.ckpt')}" in text
    assert "None" not in text and "best" not in text


def test_errors_in_words() -> None:
    values = {"position_error": 2.345, "runout_99_error": -0.12, "mean_height_error": 0.034, "speed_mean": 0.0123}
    assert described(values) == "position error 2.35 spacings, runout -12 %, mean height +3 %, 0.012 m/s at the end"
    assert described({"position_error": float("nan")}) == described({}) == "rollouts not finite"
    assert described({"position_error": 1.0, "runout_99_error": None}) == "position error 1 spacings"


def test_only_our_summaries_are_read(tmp_path: Path) -> None:
    assert read_summary(tmp_path) is None
    for content in ("{", json.dumps({"format": "another"})):
        (tmp_path / "summary.json").write_text(content)
        assert read_summary(tmp_path) is None
