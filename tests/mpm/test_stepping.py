"""A run that stops at frames is the same run; what is pushed moves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gns_pl.mpm import MPMConfig, SimulationError, simulate
from gns_pl.mpm.stepping import SteppedRun, geostatic_stress
from gns_pl.scene import FACES, Scene, Wall, column_collapse, fill_scene
from tests.conftest import SAND

CONFIG = MPMConfig(
    cell_size=1 / 12,
    points_per_direction=2,
    courant=0.5,
    transfer="affine_flip",
    damping_rate=20,
    bulk_viscosity=0.86,
    jitter=0.0,
)


def column(dim: int) -> Scene:
    walls = dict.fromkeys(FACES[dim], Wall("friction", 0.4))
    domain = (1.0, 0.25, 0.6) if dim == 3 else (1.0, 0.6)
    return column_collapse(
        domain=domain, length=0.25, height=0.4, gravity=9.81, duration=0.2, material=SAND, walls=walls
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_frame_by_frame_is_the_same_run(dim: int) -> None:
    scene = column(dim)
    whole = simulate(scene, CONFIG, frame_interval=0.02)
    run = SteppedRun(scene, CONFIG, fill_scene(scene, CONFIG.spacing), 0.02)
    for frame in range(1, whole.num_frames):
        run.advance()
        np.testing.assert_allclose(run.position, whole.position[frame], atol=1e-6)
    assert run.velocity.shape == run.position.shape


def test_a_push_moves_and_too_strong_a_push_is_told() -> None:
    scene = column(2)
    runs = [SteppedRun(scene, CONFIG, fill_scene(scene, CONFIG.spacing), 0.02) for _ in range(2)]
    change = np.zeros_like(runs[0].velocity)
    change[:, 0] = 0.1
    runs[0].add_velocity(change)
    np.testing.assert_allclose(runs[0].velocity - runs[1].velocity, change)
    for run in runs:
        run.advance()
    moved = (runs[0].position - runs[1].position)[:, 0].mean()
    assert 0.5 * 0.1 * 0.02 < moved < 1.2 * 0.1 * 0.02
    runs[0].add_velocity(1e3 * change)
    with pytest.raises(SimulationError, match="pushed"):
        runs[0].advance()


def test_geostatic_stress_carries_a_layer_that_would_drop_without() -> None:
    """A level layer between smooth walls: its weight is carried from the first step on."""
    walls = dict.fromkeys(FACES[2], Wall("slip"))
    scene = column_collapse(
        domain=(0.5, 0.6), length=0.5, height=0.4, gravity=9.81, duration=0.1, material=SAND, walls=walls
    )
    points = fill_scene(scene, CONFIG.spacing)
    depth = 0.4 - points.position[:, -1]
    fastest = []
    for stress in (np.zeros((len(depth), 7)), geostatic_stress(scene, points, SAND.density * 9.81 * depth)):
        run = SteppedRun(scene, CONFIG, points, 0.002)
        run.stress = stress
        np.testing.assert_allclose(run.stress, stress, rtol=1e-6)
        speeds = []
        for _ in range(20):
            run.advance()
            speeds.append(np.abs(run.velocity).max())
        fastest.append(max(speeds))
    assert fastest[1] < 0.25 * fastest[0]


@pytest.mark.parametrize("angle", [15.0, 30.0, 45.0])
def test_geostatic_stress_is_admissible(angle: float) -> None:
    """√J2 ≤ sin φ p without cohesion, and σ_zz the weight above."""
    sand = dataclasses.replace(SAND, friction_angle_deg=angle)
    scene = column(3).replace(materials=dict.fromkeys(column(3).materials, sand))
    points = fill_scene(scene, CONFIG.spacing)
    depth = 0.4 - points.position[:, -1]
    load = sand.density * 9.81 * depth
    xx, yy, zz, xy, yz, zx, pressure = geostatic_stress(scene, points, load).T
    np.testing.assert_allclose(pressure - zz, load)
    np.testing.assert_allclose(xx + yy + zz, 0, atol=1e-9)
    assert not (xy.any() or yz.any() or zx.any())
    root_j2 = np.sqrt((xx**2 + yy**2 + zz**2) / 2)
    assert (root_j2 <= (1 + 1e-9) * np.sin(np.radians(angle)) * pressure).all()
