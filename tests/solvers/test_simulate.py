"""Scenes become files; a run that is broken off and gone on with ends in the file of a single run."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.io.lock import locked
from gns_pl.io.stream import find_frames
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.rollout import rollout
from gns_pl.rollout.rest import REST_STEPS
from gns_pl.scene import Scene, write_scene
from gns_pl.solvers.learned import LearnedSolver
from tests.commands.in_process import ROOT, call
from tests.conftest import free_port, make_simulator, start_process, start_processes
from tests.solvers.simulated import simulate_learned

DATA = {"mpm": {"jitter": 0.6}, "store_every": [3]}


@pytest.fixture
def ckpt(tmp_path: Path) -> Path:
    save_checkpoint(tmp_path / "some.ckpt", Checkpoint(make_simulator(), DATA, {}))
    return tmp_path / "some.ckpt"


def test_every_scene_gets_its_file(ckpt: Path, drop: Scene, column: Scene, tmp_path: Path) -> None:
    paths = simulate_learned(ckpt, [drop, column.replace(duration=0.05)], out=tmp_path / "out")
    assert [path.name for path in paths] == ["cube_drop.h5", "column_collapse.h5"]
    first, second = (read_trajectory(path) for path in paths)
    assert (first.num_frames, second.num_frames) == (21, 6)
    checkpoint = Checkpoint(make_simulator(), DATA, {})
    start = LearnedSolver.of(checkpoint).start(drop)
    alone = rollout(checkpoint.simulator, start, 20)
    np.testing.assert_allclose(first.position, alone.position, atol=2e-6)
    assert first.provenance["checkpoint"] == "some.ckpt" and first.scene == drop


def test_the_jitter_is_that_of_the_data(ckpt: Path, drop: Scene) -> None:
    start = LearnedSolver.of(Checkpoint(make_simulator(), DATA, {})).start(drop)
    regular = LearnedSolver.of(Checkpoint(make_simulator(), {}, {})).start(drop)
    off = (start.position - regular.position) / 0.05
    assert 0.09 < np.abs(off).max() <= 0.1  # 0.6 / 3 of half a spacing


def test_longer_goes_on_and_shorter_is_there(ckpt: Path, drop: Scene, tmp_path: Path, capsys: object) -> None:
    simulate_learned(ckpt, [drop], out=tmp_path / "whole")
    for duration in (0.07, 0.2, 0.1):
        simulate_learned(ckpt, [drop], out=tmp_path / "parts", duration=duration)
    whole, parts = (read_trajectory(tmp_path / name / "cube_drop.h5") for name in ("whole", "parts"))
    np.testing.assert_array_equal(parts.position, whole.position)
    assert parts.scene == whole.scene


def test_a_killed_run_goes_on(ckpt: Path, drop: Scene, tmp_path: Path) -> None:
    write_scene(drop, tmp_path / "drop.yaml")
    arguments = [f"ckpt={ckpt}", f"scene={tmp_path / 'drop.yaml'}", "duration=0.6", f"out={tmp_path / 'out'}"]
    arguments += ["device=cpu", "monitor=false"]
    growing = tmp_path / "out" / "cube_drop.h5.growing"
    process = start_process(call, ROOT, "simulate.py", *arguments)
    try:
        while process.is_alive() and (not growing.exists() or find_frames(tmp_path / "out" / "cube_drop.h5") is None):
            time.sleep(0.02)
    finally:
        process.kill()
        process.join()
    command = [sys.executable, "simulate.py", *arguments]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "after" in said or "already complete" in said
    stable = {"sleep": 0.1, "min_distance": 0.2, "energy_limiter": True}  # conf/rollout/stable.yaml
    simulate_learned(ckpt, [drop], out=tmp_path / "whole", duration=0.6, monitor=False, stabilise=stable)
    whole, parts = (read_trajectory(tmp_path / name / "cube_drop.h5") for name in ("whole", "out"))
    np.testing.assert_allclose(parts.position, whole.position, atol=1e-6)


def test_a_run_killed_before_its_file_had_its_name_gets_it(ckpt: Path, drop: Scene, tmp_path: Path) -> None:
    (path,) = simulate_learned(ckpt, [drop], out=tmp_path)
    whole = read_trajectory(path)
    path.rename(tmp_path / "cube_drop.h5.growing")
    simulate_learned(ckpt, [drop], out=tmp_path)
    np.testing.assert_array_equal(read_trajectory(path).position, whole.position)
    assert not (tmp_path / "cube_drop.h5.growing").exists()


def test_a_long_history_is_taken_up_whole(drop: Scene, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "long.ckpt", Checkpoint(make_simulator(input_sequence_length=14), {}, {}))
    for out, durations in (("whole", [0.2]), ("parts", [0.16, 0.2])):
        for duration in durations:
            simulate_learned(tmp_path / "long.ckpt", [drop], out=tmp_path / out, duration=duration)
    whole, parts = (read_trajectory(tmp_path / name / "cube_drop.h5") for name in ("whole", "parts"))
    np.testing.assert_array_equal(parts.position, whole.position)


def test_a_second_run_waits_for_the_first(
    ckpt: Path, drop: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    second = threading.Thread(target=partial(simulate_learned, ckpt, [drop], out=tmp_path / "out"))
    said = ""
    with locked(tmp_path / "out" / ".simulate.lock"):
        second.start()
        while second.is_alive() and "\n" not in said:
            time.sleep(0.02)
            said += capsys.readouterr().out
        assert "another run is writing here" in said
        second.join(0.1)
        assert second.is_alive() and not (tmp_path / "out" / "cube_drop.h5.growing").exists()
    second.join()
    assert "21 frames" in capsys.readouterr().out


def simulate_launched(rank: int, port: int, arguments: list[str]) -> None:
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "RANK": str(rank), "WORLD_SIZE": "2"}
    torch.set_num_threads(1)
    done = call(ROOT, "simulate.py", *arguments)
    assert done.returncode == 0, done.stderr


def test_processes_of_torchrun_share_a_run_out(ckpt: Path, column: Scene, tmp_path: Path) -> None:
    write_scene(column, tmp_path / "column.yaml")
    arguments = [f"ckpt={ckpt}", f"scene={tmp_path / 'column.yaml'}", f"out={tmp_path / 'two'}", "device=cpu"]
    start_processes(simulate_launched, (free_port(), arguments), 2)
    simulate_learned(ckpt, [column], out=tmp_path / "one")
    one, two = (read_trajectory(tmp_path / name / "column_collapse.h5") for name in ("one", "two"))
    np.testing.assert_allclose(two.position[:10], one.position[:10], atol=1e-5)


def test_a_file_of_another_run_is_refused_and_kept(ckpt: Path, drop: Scene, tmp_path: Path) -> None:
    (path,) = simulate_learned(ckpt, [drop], out=tmp_path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"cube_drop\.h5: is of another scene, solver or checkpoint, settings"):
        simulate_learned(ckpt, [drop], out=tmp_path, seed=1)
    assert path.read_bytes() == before


def test_what_fails_is_told_and_not_tried_again(
    drop: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulator = make_simulator()
    simulator.acceleration_scale.fill_(1e38)
    save_checkpoint(tmp_path / "wild.ckpt", Checkpoint(simulator, {}, {}))
    (path,) = simulate_learned(tmp_path / "wild.ckpt", [drop], out=tmp_path)
    assert "unphysical state: positions were no longer finite at 0.01 s; run stopped" in capsys.readouterr().out
    assert read_trajectory(path).provenance["failed_at"] == 0.01
    simulate_learned(tmp_path / "wild.ckpt", [drop], out=tmp_path)
    assert "complete until it failed at 0.01 s" in capsys.readouterr().out


def test_two_scenes_of_one_name(ckpt: Path, drop: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="same name"):
        simulate_learned(ckpt, [drop, drop], out=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["ckpt=collapse"], "give scene= and either ckpt= or tolerance="),
        (["scene=column_collapse"], "give scene= and either ckpt= or tolerance="),
        (["scene=column_collapse", "ckpt=collapse", "tolerance=0.1"], "names the solver already"),
        (["scene=nowhere.yaml", "tolerance=0.1"], "nowhere.yaml"),
        (
            ["ckpt=nothing", "scene=a.yaml"],
            "nothing: there is no such checkpoint; those that come",
        ),
        (["ckpt=collapse", "scene=none.yaml"], "none.yaml"),
        (["scene=corner", "tolerance=0.1", "tolerance_of=shape"], "one of front, map, height, worse, not 'shape'"),
        (["scene=corner", "tolerance=0.1", "tolerance_of=null"], "tolerance_of must be text, not null"),
        (["scene=corner", "solver=mpm", "tolerance_of=map"], "says of which quantity a tolerance is; give one"),
        (["scene=corner", "tolerance=0.01", "tolerance_of=map"], "that can be met is 0.02 (by mpm_12.7)"),
        (["ckpt=collapse", "scene=scenes/two_blocks.yaml", "device=tpu9"], "device=tpu9 cannot be used here"),
    ],
)
def test_bad_input_is_one_sentence(arguments: list[str], sentence: str, tmp_path: Path) -> None:
    done = call(ROOT, "simulate.py", *arguments, f"out={tmp_path}")
    assert done.returncode == 2 and sentence in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_a_scene_at_rest_ends_and_says_so(
    ckpt: Path, drop: Scene, column: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = {"out": tmp_path, "rest_speed": 1e3}  # every speed is below it
    first, second = simulate_learned(ckpt, [drop, column.replace(duration=0.03)], **settings)
    made, short = read_trajectory(first), read_trajectory(second)
    assert made.num_frames == REST_STEPS + 1 and made.provenance["at_rest_from"] == pytest.approx(REST_STEPS * 0.01)
    assert short.num_frames == 4 and "at_rest_from" not in short.provenance
    printed = capsys.readouterr().out
    assert "6 frames in " in printed and "s, at rest from 0.05 s" in printed
    simulate_learned(ckpt, [drop], **settings)
    assert "complete until it came to rest at 0.05 s" in capsys.readouterr().out


def test_a_scene_of_the_catalogue_by_a_tolerance(tmp_path: Path) -> None:
    """As a user types it: the choice is explained, then run; what is said of the scene follows its keys."""
    command = ["scene=column_collapse", "scene.aspect_ratio=1.5", "tolerance=0.2"]
    command += ["scene.side_walls={condition:slip}", f"out={tmp_path / 'out'}"]

    def said(*more: str) -> str:
        done = call(ROOT, "simulate.py", *command, *more)
        assert done.returncode == 0, done.stderr
        return done.stdout

    explained = said("explain=true")
    assert "in plane strain, √(L0 H0) = 0.429 m" in explained and "chosen: " in explained
    assert not (tmp_path / "out").exists()
    assert "frames in" in said("scene.duration_tau=1")
    name = "column_collapse_aspect_ratio_1.5_duration_tau_1_side_walls_condition_slip.h5"
    made = read_trajectory(tmp_path / "out" / name)
    assert made.scene.dim == 3 and made.scene.bodies[0].size == pytest.approx((0.35, 0.5, 0.525))
    assert made.dt == pytest.approx(0.01)
