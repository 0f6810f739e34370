"""benchmark.py as a user runs it: its refusals, and the smallest chart, twice."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gns_pl.evaluation.chart.tables import Tables
from tests.commands.in_process import ROOT, call

TINY = [
    "choice.learned=[]",
    "choice.corrected=[]",
    "choice.fitted=[]",
    "choice.hybrid={}",
    "choice.cells=[3,4]",
    "trivial.cells=3",
    "reference.plane.cells_per_metre=[12,9]",
    "reference.plane.placements=1",
    "extrapolate.pairs=[[3,4]]",
    "variants.cells=[]",
    "variants.points.cells=[]",
    "variants.courant.cells=[]",
    "variants.whole.cells=[3]",
    "law.cells=3",
    "law.aspect_ratios=[1.0,2.0]",
    "batches.sizes=[1]",
    "batches.turns=1",
    "placements=1",
    "evaluation.only=[column_0.8]",
    "evaluation.duration=1.5",
]


def process(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "benchmark.py"), *arguments]
    environment = {**os.environ, **environment}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("ckpt=[nowhere.ckpt]",), "nowhere.ckpt: there is no such checkpoint"),
        (("placements=0",), "placements must be a whole number of at least 1, not 0."),
        (("from_table=true",), "runs/benchmark/plan.json: is not there yet"),
        (("sets=[nowhere]",), "nowhere/plan.json: is not there yet"),
        (("threads=[1,x]",), "threads must be a whole number of at least 1, not 'x'."),
        (("evaluation.only=[mine]",), "evaluation.only: there is no mine"),
    ],
)
def test_refusals_are_one_sentence_and_leave_nothing_behind(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    done = call(tmp_path, "benchmark.py", *arguments)
    assert done.returncode == 2
    assert done.stderr.strip().startswith(f"benchmark.py: {message}")
    assert len(done.stderr.strip().splitlines()) == 1 and not list(tmp_path.iterdir())


def test_a_missing_checkpoint_is_refused_before_torch_is_imported(tmp_path: Path) -> None:
    done = process(tmp_path, "ckpt=nowhere.ckpt", PYTHONPROFILEIMPORTTIME="1")
    assert "omegaconf" in done.stderr
    assert not any(line.endswith((" torch", " wandb")) for line in done.stderr.splitlines())


def test_the_smallest_chart_is_measured_once_and_drawn_twice(tmp_path: Path) -> None:
    done = call(tmp_path, "benchmark.py", *TINY)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "runs" / "benchmark"
    assert "[8/8]" in done.stdout and "Made:" in done.stdout
    made = {path.name for path in out.iterdir()}
    assert made >= {
        "runs.csv",
        "batches.csv",
        "plan.json",
        "chart.csv",
        "chart.md",
        "chart.png",
        "chart.svg",
        "records.csv",
    }
    assert len(list((out / "wandb").glob("offline-run-*"))) == 1
    assert len(Tables(out).runs) == 8  # a hybrid and two of depth-averaged flow come with the package
    (out / "chart.svg").unlink()
    again = process(tmp_path, "from_table=true", "logger.enabled=false")
    assert again.returncode == 0, again.stderr
    assert "[1/" not in again.stdout and (out / "chart.svg").exists()
