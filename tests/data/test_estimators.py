"""Lattices have known distances and neighbours, made-up accelerations a known gravity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gns_pl.data import estimators

BOX = (np.full(3, -1e3), np.full(3, 1e3))


def lattice(*counts: int, spacing: float = 0.05) -> NDArray[np.float64]:
    axes = [spacing * (np.arange(count) + 0.5) for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(counts))


def test_a_lattice_has_known_neighbours() -> None:
    position = lattice(5, 5, 5)
    middle, corner = len(position) // 2, 0
    queries = np.array([middle, corner])
    counts = estimators.neighbour_counts(position, np.array([0.045, 0.06, 0.075, 0.09, 0.11]), queries)
    # Shells of the cubic lattice: 6 at 1, 12 at √2, 8 at √3, 6 at 2; an eighth of the directions from a corner.
    assert counts.tolist() == [[0, 6, 18, 26, 32], [0, 3, 6, 7, 10]]
    assert estimators.nearest_distance(position, queries) == pytest.approx(0.05)


def test_neighbours_agree_with_all_pairs() -> None:
    position = np.random.default_rng(0).uniform(0, 1, (200, 3))
    distance = np.linalg.norm(position[:, None] - position[None], axis=2) + 9 * np.eye(200)
    radii, queries = np.array([0.05, 0.1, 0.3]), np.arange(0, 200, 3)
    expected = np.stack([(distance[queries] < radius).sum(axis=1) for radius in radii], axis=1)
    assert (estimators.neighbour_counts(position, radii, queries) == expected).all()
    assert estimators.nearest_distance(position, queries) == pytest.approx(distance[queries].min(axis=1))


@pytest.mark.parametrize(("counts", "tolerance"), [((8, 8, 8), 0.01), ((9, 9), 0.02)])
def test_spacing_of_a_lattice(counts: tuple[int, ...], tolerance: float) -> None:
    position = lattice(*counts)
    lower, upper = (edge[: len(counts)] for edge in BOX)
    found = estimators.interior_spacing(position, lower, upper, np.arange(len(position)), margin=0.15)
    assert found == pytest.approx(0.05, rel=tolerance)


def test_spacing_of_a_jittered_lattice_where_neighbours_mislead() -> None:
    generator = np.random.default_rng(1)
    position = lattice(10, 10, 10) + 0.7 * 0.025 * generator.uniform(-1, 1, (1000, 3))
    queries = np.arange(1000)
    assert estimators.interior_spacing(position, *BOX, queries, margin=0.15) == pytest.approx(0.05, rel=0.06)
    assert np.median(estimators.nearest_distance(position, queries)) < 0.8 * 0.05


def test_walls_are_mirrors_for_the_spacing() -> None:
    """Two layers on the floor have an inside only with their images below it."""
    position = lattice(12, 12, 2)
    queries = np.arange(len(position))
    on_floor = estimators.interior_spacing(position, np.array([-9.0, -9, 0]), np.full(3, 9.0), queries, margin=0.15)
    in_air = estimators.interior_spacing(position, *BOX, queries, margin=0.15)
    assert on_floor == pytest.approx(0.05, rel=0.03) and in_air > 1.1 * 0.05


def test_too_few_particles_have_no_spacing() -> None:
    assert math.isnan(estimators.interior_spacing(lattice(3, 3, 3), *BOX, np.arange(27), margin=0.1))


def test_gravity_is_found_among_other_motion() -> None:
    generator = np.random.default_rng(2)
    falling = np.tile([0.0, 0.0, -3.7], (60, 1)) + generator.normal(0, 0.001, (60, 3))
    flowing = generator.normal(0, 3, (400, 3))
    resting = np.zeros((200, 3))
    later = np.concatenate([falling, flowing, resting])
    earlier = np.concatenate([falling, generator.normal(0, 3, (400, 3)), resting])
    gravity, which = estimators.measure_gravity(later, earlier, 1e-3)
    assert gravity == pytest.approx(3.7, rel=1e-3)
    assert which[:60].all() and not which[60:].any()


def test_no_gravity_without_a_value_that_many_share() -> None:
    slowly = np.zeros((500, 3))
    slowly[:, 2] = -np.linspace(0.5, 9.81, 500)  # a column that gives way: steady, but each at its own rate
    gravity, which = estimators.measure_gravity(slowly, slowly, 1e-3)
    assert math.isnan(gravity) and not which.any()
    gravity, _ = estimators.measure_gravity(slowly[:5], slowly[:5], 1e-3)
    assert math.isnan(gravity)


def test_top_share() -> None:
    squares = np.concatenate([np.ones(198), [99.0, 99.0]])
    assert estimators.top_share(squares, 0.01) == pytest.approx(0.5)
    assert estimators.top_share(np.ones(50), 0.1) == pytest.approx(0.1)
    assert math.isnan(estimators.top_share(np.zeros(5), 0.1))
