"""Parameter studies with simulate.py: one scene many times, side by side, with a table at the end."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from gns_pl.io import read_trajectory
from gns_pl.metrics.curves import compute_curves
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from tests.commands.test_train import ROOT
from tests.commands.typed import typed
from tests.conftest import make_simulator

SCENE = str(ROOT / "scenes/two_blocks.yaml")
SHORT = ("device=cpu", "monitor=false", "duration=0.02")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    save_checkpoint(tmp_path / "a=b.ckpt", Checkpoint(make_simulator(connectivity_radius=0.06), {}, {}))
    return tmp_path


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.h5"))


def test_changed_scenes_have_names_of_their_own(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    for ratio in ("0.5", "0.75", "0.5"):
        run = typed(capsys, "simulate", "ckpt=a=b.ckpt", "scene=column_collapse", f"scene.aspect_ratio={ratio}", *SHORT)
        assert run.status == 0, run.err
    assert "already complete" in run.out  # the third is the first
    changes = ("scene.bodies.1.velocity=[1,0,0]", "scene.walls.x+.friction=0.2", "scene.duration=0.01")
    run = typed(capsys, "simulate", "ckpt=a=b.ckpt", f"scene={SCENE}", *changes, "device=cpu", "monitor=false")
    assert run.status == 0, run.err
    names = [Path(name).name for name in files(folder)]
    assert names[:2] == ["column_collapse_aspect_ratio_0.5.h5", "column_collapse_aspect_ratio_0.75.h5"]
    assert names[2:] == ["two_blocks_bodies.1.velocity_1_0_0_duration_0.01_walls.x+.friction_0.2.h5"]
    first, second, third = (read_trajectory(folder / name) for name in files(folder))
    assert [run.scene.bodies[0].size[-1] for run in (first, second)] == pytest.approx([0.175, 0.2625])
    assert third.scene.bodies[1].velocity == (1.0, 0.0, 0.0) and third.scene.walls["x+"].friction == 0.2
    assert third.scene.duration == 0.01 and third.num_frames == 2


def test_a_sweep_runs_all_its_jobs_and_ends_in_a_table(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    swept = ("scene.aspect_ratio=0.5,-1,0.75", "seed=0,1", "out=o")
    run = typed(capsys, "simulate", "-m", "ckpt=a=b.ckpt", "scene=column_collapse", *swept, *SHORT)
    assert run.status == 2 and "aspect_ratio must be a finite number above 0, not -1." in run.err
    name = "o/column_collapse_aspect_ratio_{}_seed_{}.h5"
    assert files(folder) == [name.format(ratio, seed) for ratio in (0.5, 0.75) for seed in (0, 1)]
    assert not list(folder.glob("*.yaml"))
    [table] = folder.glob("runs/sweeps/simulate/*/sweep.csv")
    assert str(table.relative_to(folder)) in run.out.splitlines()[-1]
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["changed"] for row in rows[:2]] == [f"scene.aspect_ratio=0.5 seed={seed}" for seed in (0, 1)]
    assert [bool(row["file"]) for row in rows] == [True, True, False, False, True, True]
    assert "above 0" in rows[2]["status"] and rows[0]["status"] == "done"
    made = read_trajectory(folder / rows[0]["file"])
    assert float(rows[0]["time_s"]) == pytest.approx(made.time[-1])
    curves, length = compute_curves(made), made.scene.bodies[0].size[0]
    for column, name in (("runout_m", "runout_99"), ("height_m", "height_max")):
        assert float(rows[0][column]) == pytest.approx(curves[name][-1] * length, rel=1e-3)
    assert all(row["file"] in run.out for row in rows)


def test_checkpoints_and_scenes_are_swept(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "c d").mkdir()
    (folder / "c d" / "e,f.ckpt").write_bytes((folder / "a=b.ckpt").read_bytes())
    jobs = ("ckpt=a=b.ckpt,c d/e,f.ckpt", f"scene=column_collapse,[{SCENE},column_collapse]")
    run = typed(capsys, "simulate", "-m", *jobs, "scene.duration_tau=0.1", "scene.name=x", *SHORT)
    assert run.status == 2  # one file has no duration_tau, and no two scenes may have one name
    names = [f"runs/simulate/x_duration_tau_0.1_ckpt_{name}.ckpt.h5" for name in ("a_b", "c_d_e_f")]
    assert files(folder) == names
