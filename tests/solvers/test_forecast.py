"""What is said before a run on a terrain is what the run then has."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.io.tables import read_table
from gns_pl.mpm.plan import make_state
from gns_pl.mpm.settings import place_points, solver_config
from gns_pl.mpm.solver import start_run
from gns_pl.scene import Terrain, read_scene
from gns_pl.solvers.catalogue import load_solver
from gns_pl.solvers.forecast import LARGE_FILE, START, forecast, needs_of
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.shallow import ShallowSolver
from gns_pl.solvers.solver import Solver
from tests.solvers.test_selection import column

SCENE = read_scene(Path(__file__).parents[2] / "scenes/landslide.yaml")


def solvers() -> tuple[MPMSolver, ShallowSolver]:
    mpm, shallow = MPMSolver.preset(cell_size=4.0), load_solver("shallow-k0")
    assert isinstance(shallow, ShallowSolver)
    return mpm, shallow


def said(solver: Solver, interval: float) -> str:
    return ". ".join(forecast(solver, SCENE, interval))


def test_cells_particles_and_frames_are_those_of_the_run() -> None:
    mpm, shallow = solvers()
    text = said(mpm, 0.5)
    size = [high - low for low, high in zip(SCENE.lower, SCENE.upper, strict=True)]
    cells = [int(number) for number in re.findall(r"(\d+) (?:×|cells)", text.split(" and ")[0])]
    assert cells == [round(edge / 4) for edge in size] and "cells of 4" in text
    points = int(re.findall(r"and ([\d,]+) particles", text)[0].replace(",", ""))
    assert points == pytest.approx(len(place_points(SCENE, mpm.settings_of(SCENE), 0).position), rel=0.05)
    assert "61 frames" in text and "on one core" in text
    run = shallow.run(SCENE.replace(duration=1.0), interval=0.5)
    assert f"{run.num_particles:,} particles" in said(shallow, 0.5)
    assert f"cells of {SCENE.terrain.cell:g} m" in said(shallow, 0.5)


def test_memory_is_that_of_the_start_up_to_that_of_a_flow_everywhere() -> None:
    """Of MPM's grid only what is written to counts: the distances to surfaces at once, the rest where material is."""
    mpm, shallow = solvers()
    particles, plan = start_run(SCENE, solver_config(mpm.settings_of(SCENE)), 0.5, 0)
    arrays = make_state(SCENE, particles, plan.grid, plan.config)
    everything, gap = sum(array.nbytes for array in arrays), arrays[9].nbytes
    needs, layer = needs_of(mpm, SCENE, 0.5), needs_of(shallow, SCENE, 0.5)
    assert needs is not None and layer is not None
    assert gap < needs.start_memory < 0.6 * everything and needs.memory == pytest.approx(everything, rel=0.05)
    assert layer.start_memory == layer.memory
    assert f"{needs.start_memory / 1e9:.2g} to {needs.memory / 1e9:.2g} GB of memory" in said(mpm, 0.5)


def test_too_many_frames_are_told_with_fewer() -> None:
    _, shallow = solvers()
    short = 1e-4
    text = said(shallow, short)
    better = float(re.findall(r"frame_interval=([\d.e-]+)", text)[0])
    number = int(re.findall(r"and ([\d,]+) particles", text)[0].replace(",", ""))
    assert 0.2 * LARGE_FILE < number * 12 * SCENE.duration / better <= LARGE_FILE
    assert "frame_interval" not in said(shallow, 0.5)


def test_a_plane_stays_as_it_is_and_a_ridge_is_smoothed() -> None:
    assert SCENE.terrain is not None
    x = np.arange(SCENE.terrain.heights.shape[0])[:, None]
    heights = {"plane": 480.0 - 0.5 * x, "ridge": 480.0 - 4.0 * abs(x - 20)}
    shifts = {}
    for name, line in heights.items():
        values = np.broadcast_to(line, SCENE.terrain.heights.shape)
        terrain = Terrain(values, SCENE.terrain.corner, SCENE.terrain.cell, SCENE.terrain.wall)
        text = forecast(MPMSolver.preset(cell_size=10.0), SCENE.replace(terrain=terrain), 0.5)[1]
        shifts[name] = float(re.findall(r"by up to (\S+) m", text)[0])
    # The mean of |x| over the 10 m around a node 2.5 m beside the ridge is 3.125 m, and its sides have a slope of 0.8.
    assert shifts["plane"] < 1e-9 and shifts["ridge"] == pytest.approx(0.8 * 0.625)


def test_the_time_is_within_a_factor_of_two_of_what_was_measured() -> None:
    """Of the example's ground and a laboratory's, many frames and few, large grids and small, by both solvers."""
    module = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks/forecast.py"))
    rows = read_table(module["TABLE"], module["Row"], "is no table of benchmarks/forecast.py")
    assert {row.case for row in rows} == set(module["CASES"])
    for row in rows:
        scene, solver, interval = module["prepared"](row.case)
        needs = needs_of(solver, scene, interval)
        assert needs is not None and 0.5 < (needs.seconds - START) / row.seconds < 2, row
        assert needs.particles == pytest.approx(row.particles, rel=0.05)


def test_of_other_scenes_nothing_is_said() -> None:
    assert forecast(solvers()[0], column(), 0.01) == []


def test_with_few_frames_the_steps_are_those_of_any_other_run() -> None:
    for solver in solvers():
        needs, often = (needs_of(solver, SCENE, interval) for interval in (SCENE.duration, 0.5))
        assert needs is not None and often is not None
        assert START < needs.seconds <= often.seconds
        with pytest.raises(InputError, match="leave no frame but its start"):
            forecast(solver, SCENE, 1000.0)
