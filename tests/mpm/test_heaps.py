"""What sand must do as a whole: rest, slide, land, keep its volume, lose energy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gns_pl.mpm import simulate
from gns_pl.scene import Body, Scene, Wall
from tests.mpm.conftest import energy, make_box, make_elastic, make_mpm, make_sand, swelling

DIMS = pytest.mark.parametrize("dim", [2, 3])


@DIMS
def test_a_full_layer_stays_at_rest(dim: int) -> None:
    size = (0.5,) * (dim - 1) + (0.2,)
    scene = make_box((0.5,) * dim, Body((0.0,) * dim, size, (0.0,) * dim), duration=0.5, wall=Wall("friction", 0.4))
    run = simulate(scene, make_mpm(points_per_direction=2), frame_interval=0.02)
    moved = np.abs(run.position - run.position[0])
    assert moved.max() < 2e-3  # ρ g H² / M is 0.3 mm; let go at once it swings over twice that, and the top may loosen
    assert np.abs(run.velocity()[-1]).max() < 1e-3


def test_a_heap_flatter_than_its_angle_stays() -> None:
    """A stepped heap, 1 up on 5 along (11°), on a floor of the same friction: only the steps' edges crumble."""
    bodies = [Body((0.0, 0.04 * level), (1.0 - 0.2 * level, 0.04), (0.0, 0.0)) for level in range(4)]
    scene = make_box((1.5, 0.5), *bodies, duration=1.0, lower_z=Wall("friction", math.tan(math.radians(30))))
    run = simulate(scene, make_mpm(cell_size=1 / 24, points_per_direction=2), frame_interval=0.02)
    moved = np.linalg.norm(run.position[-1] - run.position[0], axis=1)
    assert np.median(moved) < 2e-3
    assert abs((run.position[-1] - run.position[0])[:, 0].mean()) < 0.01
    assert np.quantile(np.linalg.norm(run.velocity()[-1], axis=1), 0.99) < 5e-3


def incline(dim: int, degrees: float, wall: Wall) -> Scene:
    """A stiff block on the floor of a tilted box (gravity is tilted)."""
    angle = math.radians(degrees)
    size, position = ((0.3, 0.2), (0.3, 0.0)) if dim == 2 else ((0.3, 0.25, 0.2), (0.3, 0.1, 0.0))
    gravity = (9.81 * math.sin(angle),) + (0.0,) * (dim - 2) + (-9.81 * math.cos(angle),)
    return make_box(
        (2.0,) + (0.5,) * (dim - 1),
        Body(position, size, (0.0,) * dim),
        duration=0.9,
        material=make_elastic(),
        gravity=gravity,
        lower_z=wall,
    )


@DIMS
@pytest.mark.parametrize("above", [-1.0, 1.0, 3.0])
def test_a_block_on_an_incline_slides_from_the_angle_of_friction_on(dim: int, above: float) -> None:
    friction = 0.3
    degrees = math.degrees(math.atan(friction)) + above
    run = simulate(incline(dim, degrees, Wall("friction", friction)), make_mpm(), frame_interval=0.01)
    speed = run.velocity()[..., 0].mean(axis=1)
    angle = math.radians(degrees)
    if above < 0:
        assert abs(speed[-1]) < 1e-3
    else:
        # Late, when the block no longer swings from being let go at once.
        late = (speed[-1] - speed[-31]) / (30 * run.dt)
        assert late == pytest.approx(9.81 * (math.sin(angle) - friction * math.cos(angle)), rel=0.02)


def test_slip_and_stick_floors() -> None:
    slipping = simulate(incline(2, 20.0, Wall("slip")), make_mpm(), frame_interval=0.01)
    speed = slipping.velocity()[..., 0].mean(axis=1)
    assert speed[-1] == pytest.approx(9.81 * math.sin(math.radians(20)) * 0.9, rel=0.01)
    sticking = simulate(incline(2, 60.0, Wall("stick")), make_mpm(), frame_interval=0.01)
    assert np.abs(sticking.position[-1] - sticking.position[0]).max() < 5e-3


@pytest.mark.parametrize("height", [0.02, 0.3])
def test_a_fallen_block_lies_on_the_floor_not_above_it(height: float) -> None:
    scene = make_box((1.0, 1.0), Body((0.35, height), (0.3, 0.2), (0.0, 0.0)), duration=2.0, material=make_elastic())
    run = simulate(scene, make_mpm(), frame_interval=0.01)
    half_spacing = 1 / 96
    assert run.position[-1][:, 1].min() == pytest.approx(half_spacing, rel=0.03)
    assert run.position[..., 1].min() > 0.85 * half_spacing


def impact(dim: int, **config: Any) -> tuple[Scene, Any]:
    """A cube of 0.3 m that meets the floor at 4 m/s."""
    size, down = (0.3,) * dim, math.sqrt(4.0**2 - 2 * 9.81 * 0.5)
    velocity = (1.0,) + (0.5,) * (dim - 2) + (-down,)
    scene = make_box(
        (1.0,) * dim,
        Body((0.35,) * (dim - 1) + (0.5,), size, velocity),
        duration=1.2,
        material=make_sand(cohesion=100.0, tension_cutoff=50.0),
        wall=Wall("friction", 0.385),
    )
    return scene, make_mpm(**config)


@pytest.mark.parametrize(("dim", "points"), [(2, 2), (2, 4), (3, 4)])
def test_a_hard_landing_keeps_the_volume(dim: int, points: int) -> None:
    scene, config = impact(dim, points_per_direction=points, jitter=0.5)
    run = simulate(scene, config, frame_interval=0.01)
    assert 0.85 < swelling(run) < 1.3
    assert np.quantile(np.linalg.norm(run.velocity()[-1], axis=1), 0.99) < 0.03
    rise = np.diff(energy(run)).max() / energy(run)[0]
    assert rise < 1e-3


def test_the_more_a_transfer_damps_the_shorter_the_column_runs() -> None:
    body, floor = Body((0.0, 0.0), (0.3, 0.5), (0.0, 0.0)), Wall("friction", 0.385)
    scene = make_box((1.5, 0.6), body, duration=0.9, lower_z=floor)
    front = {}
    for transfer in ("pic", "apic", "affine_flip"):
        run = simulate(scene, make_mpm(transfer=transfer), frame_interval=0.01)
        front[transfer] = np.quantile(run.position[-1][:, 0], 0.99)
    assert 0.3 < front["pic"] < 0.5 < front["apic"] < front["affine_flip"] < 1.4
