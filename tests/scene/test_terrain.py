"""A heightfield against planes, a sphere and sums over its bilinear surface."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene import Plane, Terrain, Wall, signed_distance

FRICTION = Wall("friction", 0.4)


def sampled(function, shape: tuple[int, ...], corner: tuple[float, ...], cell: float) -> Terrain:  # type: ignore[no-untyped-def]
    lines = [first + cell * np.arange(number) for first, number in zip(corner, shape, strict=True)]
    return Terrain(function(*np.meshgrid(*lines, indexing="ij")), corner, cell, FRICTION)


def random_terrain(dim: int) -> Terrain:
    return Terrain(np.random.default_rng(1).normal(size=(6, 5)[: dim - 1]), (1.0, -2.0)[: dim - 1], 0.5, FRICTION)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_plane_as_heights_is_the_plane_everywhere(dim: int) -> None:
    slope = np.array([-0.7, 0.3][: dim - 1])
    plane = Plane((0.0,) * (dim - 1) + (2.0,), (*-slope, 1.0), FRICTION)
    terrain = sampled(
        lambda *x: 2.0 + sum(s * a for s, a in zip(slope, x, strict=True)), (9, 7)[: dim - 1], (0.5,) * (dim - 1), 0.25
    )
    lower, upper = terrain.extent
    rng = np.random.default_rng(0)
    places = rng.uniform((*lower, -3.0), (*upper, 5.0), (200, dim))
    distance, normal = terrain.signed_distance(places)
    exact, direction = signed_distance(plane, places)
    assert np.abs(distance - exact).max() < 1e-13
    assert np.abs(normal - direction).max() < 1e-13
    finer = terrain.resampled(0.1)
    assert finer.cell == pytest.approx(0.1, rel=0.05)
    assert finer.extent[1][0] == pytest.approx(upper[0])
    assert np.abs(finer.height(places) - terrain.height(places)).max() < 1e-13


def test_the_distance_from_a_bowl_is_that_from_a_sphere() -> None:
    """Newton's step at the foot: third order in the distance, beside the surface's own error of (cell)²."""
    radius, cell = 2.0, 0.01
    terrain = sampled(lambda x, y: radius - np.sqrt(radius**2 - x**2 - y**2), (161, 161), (-0.8, -0.8), cell)
    rng = np.random.default_rng(0)
    way = rng.uniform(-0.3, 0.3, (100, 2))
    away = np.column_stack([way, -np.sqrt(1 - (way**2).sum(axis=1))])
    for above in (0.0, 0.01, 0.02):
        distance, normal = terrain.signed_distance([0, 0, radius] + (radius - above) * away)
        assert np.abs(distance - above).max() < 2e-5
        assert (normal * -away).sum(axis=1).min() > 1 - 1e-5


@pytest.mark.parametrize("dim", [2, 3])
def test_means_are_those_of_the_surface(dim: int) -> None:
    terrain = random_terrain(dim)
    edges = [np.array([0.8, 1.3, 2.05, 2.2])[:4], np.array([-2.2, -1.0, -0.1])][: dim - 1]
    means = terrain.means(edges)
    fine = 400
    for index in np.ndindex(means.shape):
        lines = [
            line[i] + (line[i + 1] - line[i]) * (np.arange(fine) + 0.5) / fine
            for i, line in zip(index, edges, strict=True)
        ]
        places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, dim - 1)
        assert means[index] == pytest.approx(terrain.height(places).mean(), abs=1e-5)


def test_volume_is_kept_where_cells_are_made_larger() -> None:
    terrain = Terrain(np.random.default_rng(2).normal(size=(12, 8)), (0.5, 0.5), 1.0, FRICTION)
    coarse = terrain.resampled(2.0)
    lower, upper = terrain.extent
    whole = [np.array([low, high]) for low, high in zip(lower, upper, strict=True)]
    assert coarse.heights.shape == (6, 4) and coarse.extent == terrain.extent
    assert coarse.heights.mean() == pytest.approx(float(terrain.means(whole)[0, 0]), abs=1e-14)


def test_a_crop_is_the_same_ground() -> None:
    terrain = random_terrain(3)
    part = terrain.cropped((1.2, -1.4), (2.1, -1.1))
    places = np.random.default_rng(0).uniform((1.2, -1.4), (2.1, -1.1), (50, 2))
    assert part.heights.shape == (4, 2)
    assert np.array_equal(part.height(places), terrain.height(places))
    assert terrain.covers((0.75, -2.25), (3.75, 0.25)) and not terrain.covers((0.7, -2.25), (3.75, 0.25))


def with_hole(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    heights = heights.copy()
    heights[2, 1] = np.nan
    return heights


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"heights": with_hole(random_terrain(3).heights)},
            r"1 of its heights are missing, the first at \[2.0, -1.5\] m",
        ),
        ({"heights": np.zeros((1, 5))}, "two heights along every axis"),
        ({"heights": np.zeros((2, 2, 2))}, "must have the shape"),
        ({"heights": "hill"}, "must be an array of numbers"),
        ({"corner": (1.0,)}, "corner must have 2 entries"),
        ({"cell": 0.0}, "cell must be a finite number above 0"),
        ({"wall": "rough"}, "wall must be a Wall"),
    ],
)
def test_what_is_no_ground_is_told(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        random_terrain(3).replace(**changes)
    assert random_terrain(3) == random_terrain(3) and hash(random_terrain(3)) == hash(random_terrain(3))
    assert random_terrain(3) != random_terrain(3).replace(wall=Wall("slip"))
