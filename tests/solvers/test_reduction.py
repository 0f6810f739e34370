"""Slices and halves of scenes: recognised, refused with the reason, and lifted back to the whole."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.mpm.settings import run_solver
from gns_pl.scene import FACES, Body, Box, Plane, Scene, Wall, column_collapse
from gns_pl.solvers.reduction import not_mirror_reason, not_plane_reason, reduce_scene, to_half, to_plane
from tests.conftest import SAND

ROUGH, SLIP = Wall("friction", 0.385), Wall("slip")
SETTINGS = {
    "cell_size": 1 / 12,
    "points_per_direction": 2,
    "courant": 0.3,
    "transfer": "affine_flip",
    "damping_rate": 20,
    "bulk_viscosity": 0.86,
    "jitter": 0.0,
}


def column(sides: Wall, **changes: object) -> Scene:
    """A column over the width of its box; x walls differ, so that only y is left to reduce."""
    walls = dict.fromkeys(FACES[3], ROUGH) | {"y-": sides, "y+": sides, "x+": Wall("stick")}
    scene = column_collapse(
        domain=(1.5, 0.5, 0.7), length=0.3, height=0.45, gravity=9.81, duration=0.4, material=SAND, walls=walls
    )
    return scene.replace(**changes)


def test_a_column_between_smooth_walls_is_in_plane_strain() -> None:
    scene = column(SLIP)
    assert not_plane_reason(scene) is None
    reduced = reduce_scene(scene)
    assert reduced.scene.dim == 2 and reduced.scene.bodies[0].size == (0.3, 0.45)
    assert "plane strain" in reduced.description
    assert reduced.scene.walls == {"x-": ROUGH, "x+": Wall("stick"), "z-": ROUGH, "z+": ROUGH}


def test_across_x_as_well() -> None:
    scene = column(SLIP, walls=dict.fromkeys(FACES[3], SLIP), bodies=(Body((0, 0, 0), (1.5, 0.2, 0.3), (0, 1, 0)),))
    reduced = reduce_scene(scene)
    assert reduced.scene.upper == (0.5, 0.7)
    assert reduced.scene.bodies[0].velocity == (1, 0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"walls": dict.fromkeys(FACES[3], ROUGH)}, "wall y- is not slip"),
        ({"bodies": (Body((0, 0.1, 0), (0.3, 0.4, 0.4), (0, 0, 0)),)}, "does not reach"),
        ({"bodies": (Body((0, 0, 0), (0.3, 0.5, 0.4), (0, 0.1, 0)),)}, "moves along y"),
        ({"gravity": (0, 1.0, -9.8)}, "gravity acts along y"),
        ({"obstacles": (Box((1, 0.1, 0), (0.1, 0.2, 0.3), ROUGH),)}, "obstacle 0 does not reach"),
        ({"obstacles": (Plane((0, 0, 0), (0, 0.1, 1), ROUGH),)}, "obstacle 0 is inclined"),
    ],
)
def test_no_plane_strain_and_why(changes: dict[str, object], reason: str) -> None:
    scene = column(SLIP, **changes)
    assert reason in str(not_plane_reason(scene))
    with pytest.raises(InputError, match=reason):
        to_plane(scene)
    assert reduce_scene(scene).scene.dim == 3


def test_obstacles_are_sliced() -> None:
    obstacles = (Box((1, 0, 0), (0.1, 0.5, 0.3), ROUGH), Plane((0, 0, 0.1), (0.2, 0, 1), ROUGH))
    scene = column(SLIP, obstacles=obstacles, bodies=(Body((0, 0, 0.2), (0.3, 0.5, 0.4), (0, 0, 0)),))
    box, plane = to_plane(scene).scene.obstacles
    assert isinstance(box, Box) and box.size == (0.1, 0.3)
    assert isinstance(plane, Plane) and len(plane.normal) == 2


def test_a_slice_makes_the_column_that_the_whole_makes() -> None:
    """With points in a lattice nothing moves across, and both runs are one to a few per cent of a cell."""
    scene = column(SLIP)
    whole = run_solver(scene, SETTINGS, frame_interval=0.02, seed=0)
    reduced = to_plane(scene)
    lifted = reduced.lift(run_solver(reduced.scene, SETTINGS, frame_interval=0.02, seed=0))
    assert lifted.scene == scene and lifted.num_particles == whole.num_particles
    assert lifted.mass.sum() == pytest.approx(whole.mass.sum(), rel=1e-5)
    assert lifted.position[..., 1].min() > 0 and lifted.position[..., 1].max() < 0.5
    for frame in (0, 10, 20):
        centres = [np.average(each.position[frame], axis=0, weights=each.mass) for each in (lifted, whole)]
        np.testing.assert_allclose(*centres, atol=0.002)
        assert lifted.position[frame, :, 0].max() == pytest.approx(whole.position[frame, :, 0].max(), abs=0.01)


def test_half_a_column_makes_the_column() -> None:
    scene = column(ROUGH)
    reduced = reduce_scene(scene)
    assert reduced.scene.upper == (1.5, 0.25, 0.7) and reduced.scene.walls["y+"] == SLIP
    assert "mirror plane in the middle of y" in reduced.description
    whole = run_solver(scene, SETTINGS, frame_interval=0.02, seed=0)
    lifted = reduced.lift(run_solver(reduced.scene, SETTINGS, frame_interval=0.02, seed=0))
    assert lifted.num_particles == whole.num_particles and lifted.scene == scene
    last = [each.position[-1].astype(np.float64) for each in (lifted, whole)]
    np.testing.assert_allclose(last[0].mean(axis=0), last[1].mean(axis=0), atol=0.003)
    assert last[0][:, 1].mean() == pytest.approx(0.25, abs=1e-6)


def test_two_bodies_that_mirror_each_other_become_one() -> None:
    left, right = Body((0.1, 0, 0.1), (0.2, 0.5, 0.2), (1, 0, 0)), Body((1.2, 0, 0.1), (0.2, 0.5, 0.2), (-1, 0, 0))
    scene = column(ROUGH, walls=dict.fromkeys(FACES[3], ROUGH), bodies=(left, right))
    assert not_mirror_reason(scene, 0) is None
    half = to_half(scene, 0)
    assert half.scene.bodies == (left,) and half.scene.upper[0] == 0.75
    both = reduce_scene(scene).scene
    assert math.prod(both.upper) == pytest.approx(1.5 * 0.5 * 0.7 / 4)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"walls": dict.fromkeys(FACES[3], ROUGH) | {"y-": SLIP}}, "walls y- and y. differ"),
        ({"bodies": (Body((0, 0.1, 0), (0.3, 0.2, 0.4), (0, 0, 0)),)}, "bodies are not mirrored"),
        ({"bodies": (Body((0, 0, 0), (0.3, 0.5, 0.4), (0, 1, 0)),)}, "bodies are not mirrored"),
        ({"gravity": (0, 1.0, -9.8)}, "gravity acts along y"),
        ({"obstacles": (Box((1, 0.1, 0), (0.1, 0.2, 0.3), ROUGH),)}, "obstacle 0 is not mirrored"),
    ],
)
def test_no_mirror_and_why(changes: dict[str, object], reason: str) -> None:
    scene = column(ROUGH, **changes)
    with pytest.raises(InputError, match=reason):
        to_half(scene, 1)


def test_what_cannot_be_reduced_stays_whole() -> None:
    scene = column(ROUGH, bodies=(Body((0, 0.1, 0), (0.3, 0.2, 0.4), (0, 0, 0)),))
    reduced = reduce_scene(scene)
    assert reduced.scene is scene and reduced.description == ""
    start = run_solver(scene.replace(duration=0.02), SETTINGS, frame_interval=0.02, seed=0)
    assert np.array_equal(reduced.lift(start).position, start.position)
    assert dataclasses.asdict(reduced.lift(start).scene) == dataclasses.asdict(scene)
