"""Any solver will do: one of a user's own goes everywhere; runs that are broken off go on; one policy for all."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gns_pl
from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint
from gns_pl.rollout import rollout
from gns_pl.rollout.policy import Policy
from gns_pl.rollout.stabilise import stabilise
from gns_pl.solvers import catalogue, recording
from gns_pl.solvers.corrected import CorrectedSolver
from gns_pl.solvers.hybrid import HybridSolver
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.recording import STATE
from gns_pl.solvers.simulate import simulate, simulate_by_choice
from gns_pl.solvers.solver import Solver
from gns_pl.solvers.trivial import Still
from tests.conftest import make_simulator
from tests.extend.page import blocks
from tests.solvers.test_selection import MPM, column


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the file of docs/extend.md."""
    (text,) = blocks("A solver")
    (tmp_path / "own_solvers.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_solvers", raising=False)
    importlib.invalidate_caches()
    return tmp_path


def test_a_solver_of_ones_own_is_named_by_its_class_and_writes_files(own: Path) -> None:
    choice = {"cells": [5], "mpm": MPM, "frame_interval": 0.05}
    (body,) = column().bodies
    scene = column(bodies=(replace(body, velocity=(0.4, 0.0, 0.0)),))
    (path,) = simulate_by_choice([scene], out=own / "out", choice=choice, solver="own_solvers.SlidingBlocks")
    trajectory = read_trajectory(path)
    assert trajectory.provenance["solver"] == "sliding_blocks" and trajectory.num_frames == 5
    travelled = (trajectory.position - trajectory.position[0])[..., 0]
    np.testing.assert_allclose(travelled[1], 0.4 * 0.05 - 0.4 * 9.81 * 0.05**2 / 2, atol=1e-6)
    np.testing.assert_allclose(travelled[-1], 0.4**2 / (2 * 0.4 * 9.81), atol=1e-6)  # v²/(2 μ g), at rest
    before = path.read_bytes()
    solver = gns_pl.load_solver("own_solvers.SlidingBlocks")
    simulate(solver, [scene], out=own / "out", interval=0.05)
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="of another scene, solver or checkpoint"):
        simulate(solver, [scene], out=own / "out", interval=0.05, seed=1)


def test_a_registered_solver_is_chosen_by_a_tolerance_once_it_was_measured(
    own: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.solvers.test_selection import record

    monkeypatch.setattr(catalogue, "REGISTERED", {})
    solver_class = type(gns_pl.load_solver("own_solvers.SlidingBlocks"))
    gns_pl.register_solver("sliding_blocks", solver_class)
    assert isinstance(gns_pl.load_solver("sliding_blocks"), Solver)
    from gns_pl.io.tables import write_table
    from gns_pl.solvers.selection import Record

    write_table(
        own / "records.csv",
        Record,
        [record("sliding_blocks", "plane", 0.02, 1e-3, 1.0), record("mpm_5", "plane", 0.01, 9.0)],
    )
    choice = {
        "cells": [5],
        "mpm": MPM,
        "frame_interval": 0.05,
        "others": ["sliding_blocks"],
        "records": own / "records.csv",
    }
    (path,) = simulate_by_choice([column()], out=own / "out", choice=choice, tolerance=0.1)
    assert read_trajectory(path).provenance["solver"] == "sliding_blocks"
    assert "chosen: sliding_blocks, the cheapest of 2" in capsys.readouterr().out
    with pytest.raises(InputError, match="runs on the CPU alone"):
        gns_pl.load_solver("sliding_blocks", device="cuda")


@pytest.mark.parametrize("kind", ["mpm", "halved", "corrected"])
def test_a_broken_run_goes_on_to_the_bits_of_a_single_one(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As after kill -9 between two saved states: frames behind the state are there and are made again."""
    scene, solver = column(), MPMSolver("mpm_5", 5.0, MPM)
    if kind == "halved":
        body = replace(scene.bodies[0], position=(0.6, 0.1, 0.0), size=(0.3, 0.3, 0.3))
        walls = scene.walls | {"y-": scene.walls["x-"], "y+": scene.walls["x-"]}
        scene = scene.replace(bodies=(body,), walls=walls)
        assert "mirror" in solver.reduced(scene).description
    if kind == "corrected":
        solver = CorrectedSolver("corrected_plane", "corrected_plane")  # type: ignore[assignment]
    monkeypatch.setattr(recording, "SAVE_EVERY", 0.0)
    settings: dict[str, Any] = {"interval": 0.02}
    (whole,) = simulate(solver, [scene], out=tmp_path / "whole", **settings)
    append, count = recording.Recording.append, [0]

    def broken(self: recording.Recording, position: np.ndarray) -> None:
        count[0] += 1
        if count[0] == 6:
            monkeypatch.setattr(recording, "SAVE_EVERY", 1e9)
        if count[0] == 8:
            raise KeyboardInterrupt
        append(self, position)

    monkeypatch.setattr(recording.Recording, "append", broken)
    with pytest.raises(SystemExit, match="the same command goes on"):
        simulate(solver, [scene], out=tmp_path / "parts", **settings)
    monkeypatch.setattr(recording.Recording, "append", append)
    capsys.readouterr()
    (parts,) = simulate(solver, [scene], out=tmp_path / "parts", **settings)
    assert "goes on after" in capsys.readouterr().out
    np.testing.assert_array_equal(read_trajectory(parts).position, read_trajectory(whole).position)
    assert not parts.with_name(parts.name + STATE).exists()
    assert read_trajectory(whole).position.shape == solver.run(scene, **settings).position.shape


def test_mpm_into_a_file_is_mpm_in_memory(tmp_path: Path) -> None:
    solver = MPMSolver("mpm_5", 5.0, MPM)
    (path,) = simulate(solver, [column()], out=tmp_path, interval=0.02)
    np.testing.assert_array_equal(read_trajectory(path).position, solver.run(column(), interval=0.02).position)


def test_one_policy_for_python_and_files(tmp_path: Path) -> None:
    """The five lines of the README give what `simulate.py` writes: stabilised, to the bit."""
    scene = column().replace(duration=0.2)
    solver = gns_pl.load_solver("column-fast-plane")
    in_memory = solver.run(scene)
    (path,) = simulate("column-fast-plane", [scene], out=tmp_path)
    np.testing.assert_array_equal(read_trajectory(path).position, in_memory.position)
    assert in_memory.provenance["stabilise"] == Policy().stabilise != {}
    assert read_trajectory(path).provenance["stabilise"] == Policy().stabilise


def test_a_run_that_rests_is_the_one_that_makes_all_its_steps() -> None:
    """Where nothing moves any more, steps are left out, and no bit changes."""
    checkpoint = load_checkpoint("collapse_plane")
    solver = LearnedSolver.of(checkpoint)
    scene = solver.reduced(column().replace(duration=2.4)).scene
    start = solver.start(scene)
    run = solver.run(scene)
    plain = rollout(stabilise(checkpoint.simulator, **Policy().stabilise), start, solver.num_steps(scene))
    assert "at_rest_from" in run.provenance and run.num_frames == plain.num_frames
    np.testing.assert_array_equal(run.position, plain.position)


def test_many_scenes_are_each_one_alone() -> None:
    solver = MPMSolver("mpm_5", 5.0, MPM)
    scenes = [column(), column(1.5)]
    for together, scene, seed in zip(solver.run_many(scenes, interval=0.05, seed=[3, 4]), scenes, (3, 4), strict=True):
        np.testing.assert_array_equal(together.position, solver.run(scene, interval=0.05, seed=seed).position)
    learned = LearnedSolver.of(Checkpoint(make_simulator(dim=2, spacing=0.05, connectivity_radius=0.1), {}, {}))
    first, second = learned.run_many(scenes)
    np.testing.assert_allclose(second.position, learned.run(scenes[1]).position, atol=1e-5)
    assert first.scene == scenes[0]


SOLVERS = ("mpm", "shallow", "learned", "hybrid", "corrected", "still")


@pytest.mark.parametrize("name", SOLVERS)
def test_frames_further_apart_than_a_scene_is_long_are_refused_and_a_short_scene_has_its_end(
    name: str, tmp_path: Path
) -> None:
    simulator = make_simulator(dim=2, spacing=0.05, connectivity_radius=0.1)
    learned = LearnedSolver.of(Checkpoint(simulator, {"mpm": {**MPM, "cell_size": 0.1}}, {}))
    made: dict[str, Any] = {
        "mpm": lambda: MPMSolver("mpm_5", 5.0, MPM),
        "shallow": lambda: gns_pl.load_solver("shallow"),
        "learned": lambda: learned,
        "hybrid": lambda: HybridSolver("hybrid", learned),
        "corrected": lambda: CorrectedSolver("corrected_plane", "corrected_plane"),
        "still": lambda: Still("still", 5.0),
    }
    solver, scene = made[name](), column()  # of 0.2 s
    for run in (solver.run, lambda scene, interval: solver.run_many([scene], interval=interval)):
        with pytest.raises(InputError, match="frames 3 s apart leave no frame but its start, since it lasts"):
            run(scene, interval=3.0)
    with pytest.raises(InputError, match="frames 3 s apart leave no frame"):
        simulate(solver, [scene.replace(name="other", duration=9.0), scene], out=tmp_path, interval=3.0)
    assert not list(tmp_path.glob("*.h5*"))
    (path,) = simulate(solver, [scene.replace(duration=1e-5)], out=tmp_path)
    assert read_trajectory(path).num_frames == 2


def test_an_end_that_frames_do_not_reach_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    choice = {"cells": [5], "mpm": MPM, "frame_interval": 0.15}
    (path,) = simulate_by_choice([column()], out=tmp_path, choice=choice, solver="mpm_5")
    assert "column_collapse: frames 0.15 s apart end at 0.15 s, not at 0.2 s." in capsys.readouterr().out
    assert read_trajectory(path).num_frames == 2
    simulate_by_choice([column()], out=tmp_path / "more", choice={**choice, "frame_interval": 0.1}, solver="mpm_5")
    assert "not at" not in capsys.readouterr().out


def test_names_that_nobody_has() -> None:
    for name, message in (
        ("nothing", "there is no nothing; there are mpm, mpm_5.09"),
        ("mpm_11", "there is no mpm_11"),
        ("nowhere.Solver", "No module named"),
        ("colum-fast", "column-fast"),
        ("gone.ckpt", "gone.ckpt: there is no such checkpoint"),
    ):
        with pytest.raises(InputError, match=message):
            gns_pl.load_solver(name)
    with pytest.raises(InputError, match=r"MPM\.preset: there is no 'coarse'"):
        gns_pl.MPM.preset("coarse", cell_size=0.1)
    assert gns_pl.MPM.preset("paper", cell_size=1 / 24).settings_of(column())["cell_size"] == 1 / 24
