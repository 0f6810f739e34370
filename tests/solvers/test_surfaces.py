"""The shipped simulator that sees surfaces, on a scene that no training had."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gns_pl.metrics.release import front_advance
from gns_pl.rollout.failure import first_failure
from gns_pl.scene import read_scene, signed_distance
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
