"""The shipped simulator that sees surfaces, on a scene that no training had."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gns_pl.io import read_trajectory
from gns_pl.metrics.release import front_advance
from gns_pl.rollout.failure import first_failure
from gns_pl.scene import fill_scene, read_scene, signed_distance
from gns_pl.solvers.catalogue import load_solver

BARRIER = Path(__file__).parents[2] / "conf" / "scenes" / "barrier.yaml"
RUNOUT = 0.527
"""Of MPM on cells of 1/36 m, 99 % of the mass [m]."""


def test_ground_runs_past_a_barrier_as_mpm_does() -> None:
    """The front is MPM's, all comes to rest, and nobody is in the barrier."""
    scene, solver = read_scene(BARRIER), load_solver("ground")
    assert solver.unsupported_reason(scene) is None and solver.out_of_range_reason(scene) is None
    run = solver.run(scene)
    assert abs(float(front_advance(run)[-1]) / RUNOUT - 1) < 0.05
    assert np.abs(run.position[-1] - run.position[-2]).max() == 0
    assert first_failure(run) is None
    assert signed_distance(scene.obstacles[0], run.position[-1])[0].min() > -1e-3


def test_mirrored_scenes_are_run_by_half(tmp_path: Path) -> None:
    """A smooth wall stands in for the mirror; a run that was broken off goes on with its half to the same bits."""
    scene, solver = read_scene(BARRIER).replace(obstacles=(), duration=0.3), load_solver("ground")
    number = fill_scene(scene, solver.spacing).position.shape[0]
    run = solver.run(scene)
    half, image = np.split(run.position, 2, axis=1)
    assert solver.size(scene)[0] == pytest.approx(number / 2, rel=0.02) and run.num_particles == number
    np.testing.assert_allclose(image, half * [1, -1, 1] + [0, 0.5, 0], atol=1e-6)
    assert half[..., 1].max() < 0.251
    for duration in (0.1, 0.3):
        solver.record([scene.replace(duration=duration)], [tmp_path / "run.h5"], interval=0.02, seed=0, monitor=False)
    np.testing.assert_array_equal(read_trajectory(tmp_path / "run.h5").position, run.position)
