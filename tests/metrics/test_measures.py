"""Every measure against a closed form."""

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.metrics import measures
from gns_pl.scene.extent import characteristic_time, initial_extent
from gns_pl.trajectory import nearest_neighbour_distance
from tests.evaluation.made_up import DT, HEIGHT, LENGTH, SPACING, column, moved, standing

G = 9.81


def test_extent_and_time_scale() -> None:
    assert initial_extent(column()) == pytest.approx((LENGTH, HEIGHT))
    assert characteristic_time(column()) == pytest.approx(np.sqrt(HEIGHT / G))


def test_time_scale_needs_gravity() -> None:
    with pytest.raises(InputError, match="no gravity"):
        characteristic_time(column().replace(gravity=(0, 0, 0)))


@pytest.mark.parametrize("dim", [2, 3])
def test_spacing_of_a_lattice(dim: int) -> None:
    assert measures.particle_spacing(standing(column(dim))) == pytest.approx(SPACING)


@pytest.mark.parametrize("spacing", [0.1, 0.05, 0.02])
def test_front_of_a_uniform_column_does_not_depend_on_resolution(spacing: float) -> None:
    still = standing(spacing=spacing)
    fronts = measures.percentile_front(still.position[..., 0], still.mass, (25, 50, 99, 99.5, 100), spacing)
    expected = np.array([0.25, 0.5, 0.99, 0.995, 1])[:, None] * LENGTH
    np.testing.assert_allclose(fronts, np.broadcast_to(expected, fronts.shape), rtol=1e-6)


def test_front_weighs_by_mass() -> None:
    x, mass = np.array([[0.5, 1.5, 2.5, 9.5]]), np.array([1.0, 1.0, 1.0, 97.0])
    fronts = measures.percentile_front(x, mass, (1, 3, 51.5), 1.0)
    np.testing.assert_allclose(fronts[:, 0], [1.0, 3.0, 9.5])


def test_front_agrees_with_a_search_by_bisection() -> None:
    generator = np.random.default_rng(1)
    x, mass, width = generator.uniform(0, 1, (1, 200)), generator.uniform(0.5, 2, 200), 0.03
    front = float(measures.percentile_front(x, mass, (90,), width)[0, 0])
    covered = np.sum(mass * np.clip((front - x[0]) / width + 0.5, 0, 1))
    assert covered == pytest.approx(0.9 * mass.sum(), rel=1e-9)


def test_mean_height_of_a_column_and_its_shift() -> None:
    still = standing()
    centre = measures.centre_of_mass(moved(still, np.arange(5)[:, None] * [0.1, 0, 0.01]))
    np.testing.assert_allclose(centre[0], [LENGTH / 2, 0.25, HEIGHT / 2], rtol=1e-6)
    np.testing.assert_allclose(centre[4] - centre[0], [0.4, 0, 0.04], atol=1e-6)


def wedge(spacing: float, length: float = 1.0, height: float = 0.4) -> np.ndarray:
    """Points that fill a triangle h(x) = H (1 − x/L) on the floor, one per square of the lattice."""
    x = (np.arange(round(length / spacing)) + 0.5) * spacing
    columns = [np.arange(spacing / 2, height * (1 - each / length), spacing) for each in x]
    return np.array([(each, z) for each, column in zip(x, columns, strict=True) for z in column])


def half_disc(spacing: float, radius: float = 0.5) -> np.ndarray:
    """Points that fill a half-disc on the floor around x = 0.6 m."""
    grid = np.stack(np.meshgrid(np.arange(spacing / 2, 1.4, spacing), np.arange(spacing / 2, 0.7, spacing)), axis=-1)
    points = grid.reshape(-1, 2)
    return points[((points - [0.6, 0.0]) ** 2).sum(axis=1) < radius**2]


def test_a_wedge_has_its_profile_its_centre_and_its_front() -> None:
    points = wedge(0.005)
    mass = np.full(len(points), 2.0)
    x, height = measures.deposit_profile(points, mass, column(2), 0.02)
    inside = x < 0.95
    np.testing.assert_allclose(height[inside], 0.4 * (1 - x[inside]), atol=0.012)
    assert not height[x > 1.02].any()
    assert np.sum(height) * 0.02 == pytest.approx(0.2, rel=0.01)
    # Of a triangle 99 % of the area lies before 1 − √0.01 of its length.
    front = measures.percentile_front(points[None, :, 0], mass, (99, 100), 0.005)
    np.testing.assert_allclose(front[:, 0], [0.9, 1.0], atol=0.01)
    assert points.mean(axis=0) == pytest.approx([1 / 3, 0.4 / 3], abs=0.004)


def test_a_half_disc_has_its_profile_and_its_centre() -> None:
    points = half_disc(0.005)
    x, height = measures.deposit_profile(points, np.ones(len(points)), column(2), 0.02)
    inside = abs(x - 0.6) < 0.47
    np.testing.assert_allclose(height[inside], np.sqrt(0.25 - (x[inside] - 0.6) ** 2), atol=0.012)
    assert points.mean(axis=0) == pytest.approx([0.6, 4 * 0.5 / (3 * np.pi)], abs=0.003)


@pytest.mark.parametrize(("dim", "squeezed"), [(2, 1.0), (3, 1.0), (2, 0.8), (3, 0.5)])
def test_a_block_is_full_and_a_squeezed_one_fuller(dim: int, squeezed: float) -> None:
    """Also at floor, wall and edges of the box, where the grid's nodes have less room."""
    still = standing(column(dim, length=1.5, height=0.6))
    position = still.position[0].astype(np.float64)
    position[:, -1] *= squeezed
    found = measures.solid_fraction(position, still.volume().astype(np.float64), still.scene, 2.5 * SPACING)
    inner = position[:, -1] < 0.6 * squeezed - 0.16
    np.testing.assert_allclose(found[inner], 1 / squeezed, rtol=0.12)
    assert found[inner].mean() == pytest.approx(1 / squeezed, rel=0.02)
    assert found[~inner].mean() < found[inner].mean()


def test_transport_of_a_shift_is_the_shift_and_of_a_permutation_nothing() -> None:
    points = np.random.default_rng(0).uniform(0, 1, (500, 3))
    assert measures.sinkhorn_distance(points, points) < 1e-6
    few = points[:200]  # so that all of them are compared
    assert measures.sinkhorn_distance(few, np.random.default_rng(1).permutation(few)) < 1e-3
    assert measures.sinkhorn_distance(points, points + np.array([0.3, 0, 0])) == pytest.approx(0.3, rel=0.03)
    stretched = points * [2, 1, 1]  # E (2u − u)² = 1/3
    assert measures.sinkhorn_distance(points, stretched) == pytest.approx(3**-0.5, rel=0.06)
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(5), np.arange(2), indexing="ij"), axis=-1).reshape(-1, 3)
    for shift in ((3.0, 0, 0), (0, 3.0, 0)):  # far beyond ε, along and across a long body
        assert measures.sinkhorn_distance(grid, grid + np.array(shift)) == pytest.approx(3.0, rel=1e-6)


def test_energies_of_free_fall() -> None:
    still = replace(standing(frames=11), scene=column())
    time = still.time
    falling = moved(still, -0.5 * G * time[:, None] ** 2 * np.array([0, 0, 1]))
    mass = 1800 * LENGTH * 0.5 * HEIGHT
    kinetic, potential = measures.kinetic_energy(falling), measures.potential_energy(falling)
    assert kinetic[0] == 0
    # a backward difference is the speed half a frame earlier
    np.testing.assert_allclose(kinetic[1:], 0.5 * mass * (G * (time[1:] - DT / 2)) ** 2, rtol=1e-4)
    np.testing.assert_allclose(potential, mass * G * (HEIGHT / 2 - 0.5 * G * time**2), rtol=1e-4, atol=1e-2)


def test_speeds_are_those_of_a_steady_motion() -> None:
    still = standing()
    velocity = np.array([3.0, 0.0, 4.0])
    steady = moved(still, still.time[:, None] * velocity)
    steady = replace(steady, initial_velocity=np.tile(velocity, (still.num_particles, 1)).astype(np.float32))
    np.testing.assert_allclose(measures.speeds(steady), 5.0, rtol=1e-4)


def test_penetration_is_the_depth_outside_the_box() -> None:
    still = standing(frames=2)
    position = still.position.copy()
    position[1, 0] = (-0.02, 0.1, -0.03)
    position[1, 1] = (0.1, 0.57, 0.1)
    depth = measures.penetration(replace(still, position=position))
    assert depth[0].max() == 0
    assert depth[1, 0] == pytest.approx(0.03, abs=1e-6)
    assert depth[1, 1] == pytest.approx(0.07, abs=1e-6)
    assert depth[1, 2:].max() == 0


def test_nearest_neighbours_of_a_lattice_with_one_pair_pushed_together() -> None:
    position = standing().position[0].astype(np.float64)
    position[0] = position[1] + [0, 0, 0.01]
    distance = nearest_neighbour_distance(position)
    assert distance[0] == distance[1] == pytest.approx(0.01)
    assert np.median(distance) == pytest.approx(SPACING, rel=1e-5)


def test_arrest_is_when_the_front_has_come_to_its_end() -> None:
    time = np.linspace(0, 6, 61)
    assert measures.arrest_time(time, np.minimum(time, 3.0)) == pytest.approx(3.0, abs=0.1)
    assert measures.arrest_time(time, time) == pytest.approx(5.9)  # creeps to the end
    assert np.isnan(measures.arrest_time(time, np.zeros(61)))
    assert np.isnan(measures.arrest_time(time, -time))


def test_profile_of_a_column_is_a_box() -> None:
    still = standing()
    middle, height = measures.deposit_profile(still.position[0].astype(float), still.mass, still.scene, 0.1)
    assert len(middle) == 15
    np.testing.assert_allclose(height, np.where(middle < LENGTH, HEIGHT, 0), rtol=1e-6, atol=1e-12)


def test_squared_error_of_a_shift() -> None:
    still = standing()
    shifted = moved(still, np.arange(5)[:, None] * [0.3, 0, 0])
    squared = measures.position_mse(shifted, still)
    np.testing.assert_allclose(squared, 0.09 * np.arange(5) ** 2 / 3, rtol=1e-5)
    assert measures.rollout_mse(squared, 1) == pytest.approx(0.03, rel=1e-5)
    assert measures.rollout_mse(squared, 4) == pytest.approx(0.03 * (1 + 4 + 9 + 16) / 4, rel=1e-5)
    assert np.isnan(measures.rollout_mse(squared, 5))


def test_trajectories_that_cannot_be_compared() -> None:
    with pytest.raises(InputError, match="particle by particle"):
        measures.position_mse(standing(), standing(spacing=0.1))
    with pytest.raises(InputError, match="time steps"):
        measures.position_mse(standing(), standing(dt=0.01))
