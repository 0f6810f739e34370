"""Obstacles against closed forms, against walls of the box in the same place, and against the scene's own geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gns_pl.mpm import simulate
from gns_pl.mpm.obstacles import obstacle_table
from gns_pl.mpm.obstacles import signed_distance as kernel_distance
from gns_pl.scene import Body, Box, Obstacle, Plane, Scene, Wall, read_scene, signed_distance
from tests.mpm.conftest import make_box, make_elastic, make_mpm

DIMS = pytest.mark.parametrize("dim", [2, 3])
FRICTION = Wall("friction", 0.385)


@DIMS
def test_the_kernel_measures_as_the_scene_does(dim: int) -> None:
    rng = np.random.default_rng(0)
    obstacles: tuple[Obstacle, ...] = (
        Plane(tuple(rng.uniform(0, 1, dim)), tuple(rng.normal(size=dim)), FRICTION),
        Box(tuple(rng.uniform(0, 0.5, dim)), tuple(rng.uniform(0.2, 0.5, dim)), Wall("stick")),
    )
    lower = (-0.5, 0.1, -1.0)[3 - dim :]
    scene = make_box((2.0,) * dim, Body((1.5,) * dim, (0.1,) * dim, (0.0,) * dim), duration=1.0)
    scene = scene.replace(lower=lower, obstacles=obstacles)
    axes = (0, 2) if dim == 2 else (0, 1, 2)
    corner = np.zeros(3)
    corner[list(axes)] = lower
    table = obstacle_table(scene, tuple(corner), axes)
    places = rng.uniform(-1, 2, (200, dim))
    for obstacle, row in zip(obstacles, table, strict=True):
        distance, normal = signed_distance(obstacle, places)
        for place, wanted, direction in zip(places, distance, normal, strict=True):
            full = np.zeros(3)
            full[list(axes)] = place - lower
            got, *towards = kernel_distance(row, *full)
            assert got == pytest.approx(wanted, abs=1e-12)
            assert np.array(towards)[list(axes)] == pytest.approx(direction, abs=1e-9)


@DIMS
@pytest.mark.parametrize("friction", [0.0, 0.2, 0.6])
def test_a_block_slides_down_a_slope_as_newton_says(dim: int, friction: float) -> None:
    """A stiff block cut by a slope of 25°; tan 25° = 0.466."""
    angle = math.radians(25)
    normal = (math.sin(angle),) + (0.0,) * (dim - 2) + (math.cos(angle),)
    along = np.array((math.cos(angle),) + (0.0,) * (dim - 2) + (-math.sin(angle),))
    body = Body((0.1,) * (dim - 1) + (0.5,), (0.3,) * (dim - 1) + (0.4,), (0.0,) * dim)
    box = (1.5, *(0.5,) * (dim - 2), 1.0)
    slope = Plane((0.0,) * (dim - 1) + (0.7,), normal, Wall("friction", friction))
    scene = make_box(box, body, duration=0.4, material=make_elastic()).replace(obstacles=(slope,))
    run = simulate(scene, make_mpm(), frame_interval=0.01)
    velocity = run.velocity().mean(axis=1)
    late = (velocity[-1] - velocity[-16]) / (15 * run.dt)
    expected = max(9.81 * (math.sin(angle) - friction * math.cos(angle)), 0.0)
    assert late @ along == pytest.approx(expected, rel=0.01, abs=0.05)
    assert abs(velocity[-1] @ np.array(normal)) < 0.01
    assert all(signed_distance(slope, frame)[0].min() > 0 for frame in run.position)


def floor_scene(surface: float, *obstacles: Obstacle) -> Scene:
    body = Body((0.0, surface), (0.3, 0.6), (0.0, 0.0))
    return make_box((2.5, 0.8 + surface), body, duration=1.4, wall=FRICTION).replace(obstacles=obstacles)


def test_a_floor_between_nodes_is_as_good_as_the_boxs_own() -> None:
    """The surface is known to a fraction of a cell, so runout and height agree within some percent."""
    surface = 0.07
    config = make_mpm(cell_size=1 / 24, points_per_direction=2, jitter=0.5)
    plane, block = Plane((0.0, surface), (0.0, 1.0), FRICTION), Box((-1.0, -1.0), (5.0, 1.0 + surface), FRICTION)
    runs = [
        simulate(scene, config, frame_interval=0.02).position[-1]
        for scene in (floor_scene(0.0), floor_scene(surface, plane), floor_scene(surface, block))
    ]
    front = [np.quantile(run[:, 0], 0.99) for run in runs]
    height = [run[:, 1].mean() - surface * (index > 0) for index, run in enumerate(runs)]
    assert np.array_equal(runs[1], runs[2])
    assert front[1] == pytest.approx(front[0], rel=0.08)
    assert height[1] == pytest.approx(height[0], rel=0.08)


@DIMS
def test_nothing_gets_into_a_box_and_a_wide_one_stops_the_flow(dim: int) -> None:
    width = (0.3,) * (dim - 2)
    body = Body((0.0,) * dim, (0.25, *width, 0.35), (0.0,) * dim)
    scene = make_box((1.2, *width, 0.5), body, duration=0.8, lower_z=FRICTION)
    dam = Box((0.6, *(-1.0,) * (dim - 2), -0.1), (0.15, *(3.0,) * (dim - 2), 0.4), FRICTION)
    config = make_mpm(cell_size=1 / 24 if dim == 2 else 1 / 16, points_per_direction=2, jitter=0.5)
    free, held = (simulate(s, config, frame_interval=0.02) for s in (scene, scene.replace(obstacles=(dam,))))
    assert free.position[-1][:, 0].max() > 0.7
    assert held.position[..., 0].max() < 0.6
    assert all(signed_distance(dam, frame)[0].min() >= 0 for frame in held.position)


def test_the_example_scene_runs_around_its_barrier() -> None:
    scene = read_scene("scenes/slope_with_barrier.yaml").replace(duration=0.6)
    run = simulate(scene, make_mpm(points_per_direction=2, jitter=0.5), frame_interval=0.02)
    for obstacle in scene.obstacles:
        assert all(signed_distance(obstacle, frame)[0].min() >= -1e-6 for frame in run.position)
    assert len(np.unique(run.material[:, 0])) == 2
    assert np.isfinite(run.position).all()
    assert np.quantile(run.position[-1][:, 0], 0.9) > 0.6
