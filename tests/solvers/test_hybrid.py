"""What a heap does that MPM takes over from a learned simulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.mpm.settings import run_solver, stepped_run
from gns_pl.rollout.policy import Policy
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.solvers.correction import points_of
from gns_pl.solvers.hybrid import HybridSolver, continued_by_mpm
from gns_pl.solvers.learned import LearnedSolver
from tests.conftest import MPM as mpm_settings
from tests.conftest import SAND, make_simulator
from tests.solvers.test_selection import DATA

MPM = {**mpm_settings, "cell_size": 0.1, "points_per_direction": 2, "precision": "float32"}


def column(duration: float = 0.2, dim: int = 2) -> Scene:
    walls = dict.fromkeys(FACES[dim], Wall("friction", 0.385))
    if dim == 3:
        walls |= {"y-": Wall("slip"), "y+": Wall("slip")}
    domain = (1.5, 0.9) if dim == 2 else (1.5, 0.3, 0.9)
    return column_collapse(
        domain=domain, length=0.3, height=0.3, gravity=9.81, duration=duration, material=SAND, walls=walls
    )


def test_a_settled_heap_is_not_kicked() -> None:
    """Handed to MPM, a heap moves by less than a hundredth of its spacing, and less than with no stress at all."""
    settled = run_solver(column(1.6), MPM, frame_interval=0.01, seed=0)
    heap = replace(settled, position=settled.position[:-19])
    kept = continued_by_mpm(heap, MPM, 20)
    assert kept.num_frames == heap.num_frames + 20
    run = stepped_run(heap.scene, MPM, points_of(heap, -1), 0.01)
    for _ in range(20):
        run.advance()
    last = heap.position[-1]
    moved, dropped = (np.linalg.norm(each - last, axis=1).mean() for each in (kept.position[-1], run.position))
    assert moved < 0.01 * 0.05 and moved < 0.7 * dropped


def test_a_falling_body_falls_on() -> None:
    scene = column(0.1)
    body = replace(scene.bodies[0], position=(0.5, 0.4), velocity=(0.5, 0.0))
    scene = scene.replace(bodies=(body,))
    whole = run_solver(scene, MPM, frame_interval=0.01, seed=0)
    half = replace(whole, position=whole.position[:6])
    again = continued_by_mpm(half, MPM, 5)
    np.testing.assert_allclose(again.position.mean(axis=1), whole.position.mean(axis=1), atol=6e-4)


def test_a_learned_run_goes_on_by_mpm(tmp_path: Path) -> None:
    simulator = make_simulator(dim=2, spacing=0.05, connectivity_radius=0.1)
    save_checkpoint(tmp_path / "flat.ckpt", Checkpoint(simulator, {**DATA, "mpm": MPM}, {}))
    learned = LearnedSolver("flat", tmp_path / "flat.ckpt", Policy({}))
    solver = HybridSolver("both", learned, until=0.4)
    scene = column(dim=3)
    assert solver.shares(scene) == (7, 13) and solver.cost(scene) > 0
    made = solver.run(scene, interval=0.01, seed=0)
    assert made.scene == scene and made.num_frames == 21 and np.isfinite(made.position).all()
    assert made.mass.sum() == pytest.approx(1800 * 0.3 * 0.3 * 0.3, rel=1e-5)
    assert made.position.min() >= 0
    other = HybridSolver("both", learned, until=9.0)
    assert other.shares(scene) == (20, 0) and other.run(scene, interval=0.01, seed=0).num_frames == 21


def test_what_makes_no_hybrid_is_refused() -> None:
    with pytest.raises(InputError, match="until above 0"):
        HybridSolver("both", LearnedSolver("x", "x"), until=0.0)
