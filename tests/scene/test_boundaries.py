"""Distances to obstacles against brute force, and refusals; walls are tested with the scene."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Box, Obstacle, Plane, Wall, signed_distance

WALL = Wall("friction", 0.4)
OBSTACLES: dict[str, Obstacle] = {
    "plane": Plane((0.1, 0.2, 0.3), (1, -2, 3), WALL),
    "flat plane": Plane((0.1, 0.3), (-1, 2), WALL),
    "box": Box((0.1, -0.2, 0.3), (0.5, 0.3, 0.2), WALL),
    "rectangle": Box((0.1, 0.3), (0.5, 0.2), WALL),
}


def surface(box: Box, number: int) -> np.ndarray:
    """Points all over the faces of a box, `number` along each edge."""
    axes = [np.linspace(low, high, number) for low, high in zip(box.position, box.upper, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    return grid[((grid == box.position) | (grid == box.upper)).any(axis=1)]


@pytest.mark.parametrize("name", ["box", "rectangle"])
def test_distance_to_a_box_is_that_of_its_nearest_surface_point(name: str) -> None:
    box = OBSTACLES[name]
    assert isinstance(box, Box)
    around = np.subtract(box.position, 0.1), np.add(box.upper, 0.1)
    places = np.random.default_rng(0).uniform(*around, (200, len(box.size)))
    inside = ((places > box.position) & (places < box.upper)).all(axis=1)
    assert 20 < inside.sum() < 100
    number = 61
    brute = np.array([np.linalg.norm(surface(box, number) - place, axis=1).min() for place in places])
    distance = signed_distance(box, places)[0]
    np.testing.assert_array_equal(distance < 0, inside)
    # No sampled point is nearer than the nearest one, and one of them is at most half a sampling cell beside it.
    assert (brute >= np.abs(distance) - 1e-12).all()
    assert (brute**2 <= distance**2 + sum((edge / (number - 1) / 2) ** 2 for edge in box.size) + 1e-12).all()


@pytest.mark.parametrize("obstacle", OBSTACLES.values(), ids=OBSTACLES)
def test_the_normal_leads_to_the_surface_and_is_the_gradient(obstacle: Obstacle) -> None:
    dim = len(obstacle.point if isinstance(obstacle, Plane) else obstacle.position)
    places = np.random.default_rng(1).uniform(-0.5, 1, (100, dim))
    distance, normal = signed_distance(obstacle, places)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(signed_distance(obstacle, places - distance[:, None] * normal)[0], 0, atol=1e-12)
    step = 1e-7
    for axis in range(dim):
        moved = signed_distance(obstacle, places + step * np.eye(dim)[axis])[0]
        np.testing.assert_allclose((moved - distance) / step, normal[:, axis], atol=1e-5)


def test_planes_have_a_free_and_a_filled_side() -> None:
    plane = Plane((0, 0, 0.5), (1, 0, 1), WALL)
    distance, normal = signed_distance(plane, [[0, 0, 0.5], [0.5, 7, 0], [1, 0, 1], [0, 0, 0]])
    np.testing.assert_allclose(distance, [0, 0, 1.5 / math.sqrt(2), -0.5 / math.sqrt(2)], atol=1e-15)
    np.testing.assert_allclose(normal, [[math.sqrt(0.5), 0, math.sqrt(0.5)]] * 4)


def test_on_faces_edges_and_corners_the_normal_is_still_a_unit_vector() -> None:
    box = Box((0, 0, 0), (1, 1, 1), WALL)
    distance, normal = signed_distance(box, [[1, 0.5, 0.5], [0, 0, 0.5], [1, 1, 1], [0.5, 0.5, 0.5]])
    np.testing.assert_array_equal(distance, [0, 0, 0, -0.5])
    np.testing.assert_array_equal(normal, [[1, 0, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0]])


def test_normals_become_unit_vectors_once() -> None:
    for seed in range(200):
        plane = Plane((0, 0, 0), tuple(np.random.default_rng(seed).normal(size=3)), WALL)
        assert math.hypot(*plane.normal) == pytest.approx(1, abs=1e-15)
        assert Plane(plane.point, plane.normal, WALL) == plane  # to the last bit, or files would change a scene


@pytest.mark.parametrize(
    ("cls", "arguments", "sentence"),
    [
        (Plane, ((0, 0, 0), (0, 0, 0)), "plane: normal must point somewhere"),
        (Plane, ((0, 0, 0), "up"), "plane: normal must be a list of numbers"),
        (Plane, ((0, 0, math.nan), (0, 0, 1)), "plane: point must hold finite numbers"),
        (Box, ((0, 0, 0), (1, 0, 1)), "box: size must be positive along every axis"),
        (Box, ((0, 0, 0), (1, -1, 1)), "box: size must be positive"),
        (Box, (3, (1, 1, 1)), "box: position must be a list of numbers"),
    ],
)
def test_refusals(cls: Any, arguments: tuple[Any, ...], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        cls(*arguments, WALL)
