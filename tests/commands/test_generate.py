"""generate.py as a user runs it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gns_pl.io import read_trajectory, verify_dataset
from tests.commands.in_process import call

DOOR = Path(__file__).parents[2] / "generate.py"
SMALL = [
    "data=quickstart",
    "data.name=tiny",
    "data.mpm.cell_size=0.25",
    "data.frame_interval=0.01",
    *(f"~data.families.{body}_{size}" for body in ("block", "column") for size in ("low", "middle", "high")),
    "data.families.cube_drop.count=2",
    "data.families.cube_drop.valid=1",
    "data.families.cube_drop.test=0",
    "data.families.cube_drop.duration=0.05",
    "num_workers=1",
]


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(DOOR), *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def test_makes_a_data_set_where_the_user_is_and_nothing_else(tmp_path: Path) -> None:
    done = run(tmp_path, *SMALL)
    assert done.returncode == 0, done.stderr
    assert "tiny: 2 trajectories" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["datasets"]
    manifest = verify_dataset(tmp_path / "datasets" / "tiny")
    assert len(manifest.files) == 2
    trajectory = read_trajectory(tmp_path / "datasets" / "tiny" / "trajectory_0000.h5")
    assert trajectory.num_frames == 6
    again = call(tmp_path, "generate.py", *SMALL)
    assert (again.returncode, again.stderr) == (0, "")
    other = call(tmp_path, "generate.py", *SMALL, "data.seed=3")
    assert other.returncode == 2
    assert other.stderr == (
        "generate.py: datasets/tiny: holds another data set (seed is 0 there and 3 is asked for); "
        "choose another folder, or remove it.\n"
    )


def test_a_fine_set_has_a_folder_for_every_spacing(tmp_path: Path) -> None:
    few = [f"data.families.cube_drop.{setting}" for setting in ("count=2", "valid=1", "test=0", "duration=0.02")]
    done = call(
        tmp_path, "generate.py", "data=cube106_fine", "data.mpm.cell_size=0.125", *few, "num_workers=1", "device=cpu"
    )
    assert done.returncode == 0, done.stderr
    assert "GB, every 2 and every 4) by 1 process." in done.stderr
    for every in (2, 4):
        manifest = verify_dataset(tmp_path / "datasets" / "cube106_fine" / f"every_{every}")
        assert (len(manifest.files), manifest.spacing) == (2, every / 16)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["data.families.cube_drop.side=[0.4,0.2]"], "side must be two positive numbers, the smaller first"),
        (["data.mpm.courant=7"], "mpm: courant 7 is above the limit"),
        (["+data.families.cube_drop.colour=red"], "family cube_drop: unknown key colour"),
        ([f"data.root={os.devnull}"], "/dev/null: is a file, not a folder."),
        (["device=gpu"], "device must be one of auto, cpu, cuda, not 'gpu'."),
        (["data.frame_interval=9"], "frames 9 s apart leave no frame but its start, since it lasts "),
        (["+data.every=2"], "every is 2, but the set is stored with every 1; choose one of these."),
        (["+data.store_every=[2,50]"], "lattice places, too few to keep every 50; choose less."),
    ],
)
def test_wrong_input_is_one_sentence(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    done = call(tmp_path, "generate.py", *SMALL, *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("generate.py: ")
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
