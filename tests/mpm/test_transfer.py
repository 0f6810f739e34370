from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gns_pl.mpm.shape import axis_shape
from gns_pl.mpm.transfer import WALL_MARGIN, grid_to_points, keep_inside, points_to_grid
from tests.mpm.conftest import LAYERS, Points, make_points

NO_OBSTACLES = np.zeros((0, 8))
DIMS = pytest.mark.parametrize("dim", [2, 3])


def to_grid(points: Points, *, affine_fraction: float = 1.0, dt: float = 1e-3) -> None:
    points_to_grid(
        0, len(points.mass), points.order, points.position, points.velocity, points.affine, points.stress,
        points.mass, points.volume, points.index, points.materials, points.grid, points.gap, points.cells, points.nodes,
        points.inverse_cell, NO_OBSTACLES, LAYERS[points.dim], affine_fraction, dt,
    )  # fmt: skip


def to_points(points: Points, *, flip_fraction: float, dt: float = 0.0) -> int:
    put_back: int = grid_to_points(
        0, len(points.mass), points.position, points.velocity, points.affine, points.stress,
        points.index, points.materials, points.grid, points.cells, points.nodes, points.inverse_cell,
        NO_OBSTACLES, LAYERS[points.dim], flip_fraction, dt,
    )  # fmt: skip
    return put_back


def divide(points: Points) -> None:
    """Momentum to velocity, nothing else."""
    held = points.grid[:, 3] > 0
    points.grid[held, :3] /= points.grid[held, 3:4]
    points.grid[:, 4:7] = 0.0


def moment(points: Points) -> NDArray[np.float64]:
    """Σ m (x ⊗ v + D Cᵀ); its antisymmetric part is the angular momentum of points with affine velocities."""
    size = np.array(points.cell)
    total = np.zeros((3, 3))
    for p, mass in enumerate(points.mass):
        second = np.zeros(3)
        for axis in (0, 2) if points.dim == 2 else (0, 1, 2):
            second[axis] = axis_shape(points.position[p, axis], points.cells[axis])[-1] * size[axis] ** 2
        place = points.acting[p]
        total += mass * (np.outer(place, points.velocity[p]) + np.diag(second) @ points.affine[p].reshape(3, 3).T)
    return total


def spin(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    return tensor - tensor.T


@DIMS
@pytest.mark.parametrize("affine_fraction", [0.0, 1.0])
def test_p2g_conserves_mass_and_momentum(dim: int, affine_fraction: float) -> None:
    points = make_points(dim)
    to_grid(points, affine_fraction=affine_fraction)
    assert points.grid[:, 3].sum() == pytest.approx(points.mass.sum(), rel=1e-13)
    assert points.grid[:, :3].sum(axis=0) == pytest.approx(points.mass @ points.velocity, abs=1e-12)


@DIMS
def test_stresses_push_with_no_net_force_and_no_torque(dim: int) -> None:
    points = make_points(dim, stressed=True)
    points.affine[:] = 0
    to_grid(points)
    impulse = points.grid[:, 4:7]
    scale = np.abs(impulse).sum()
    assert scale > 0
    assert np.abs(impulse.sum(axis=0)).max() < 1e-13 * scale
    assert np.abs(spin(points.node_position.T @ impulse)).max() < 1e-13 * scale


@DIMS
def test_apic_conserves_angular_momentum_both_ways(dim: int) -> None:
    points = make_points(dim)
    before = spin(moment(points))
    to_grid(points)
    assert spin(points.node_position.T @ points.grid[:, :3]) == pytest.approx(before, abs=1e-12)
    divide(points)
    to_points(points, flip_fraction=0.0)
    assert spin(moment(points)) == pytest.approx(before, abs=1e-12)


@DIMS
@pytest.mark.parametrize("flip_fraction", [0.0, 0.9, 1.0])
def test_g2p_conserves_momentum(dim: int, flip_fraction: float) -> None:
    points = make_points(dim)
    before = points.mass @ points.velocity
    to_grid(points)
    divide(points)
    to_points(points, flip_fraction=flip_fraction)
    assert points.mass @ points.velocity == pytest.approx(before, abs=1e-12)


@DIMS
def test_linear_velocity_fields_survive_the_way_to_the_grid_and_back(dim: int) -> None:
    points = make_points(dim, number=400)
    gradient = np.random.default_rng(1).normal(size=(3, 3))
    if dim == 2:
        gradient[1], gradient[:, 1] = 0, 0
    points.velocity[:] = points.acting @ gradient.T
    points.affine[:] = gradient.ravel()
    expected = points.velocity.copy()
    to_grid(points)
    divide(points)
    to_points(points, flip_fraction=0.0)
    assert points.velocity == pytest.approx(expected, abs=1e-12)
    assert points.affine == pytest.approx(np.tile(gradient.ravel(), (400, 1)), abs=1e-10)


@DIMS
def test_flip_keeps_what_the_grid_cannot_see(dim: int) -> None:
    points = make_points(dim)
    noisy = points.velocity.copy()
    to_grid(points)
    divide(points)
    points.grid[:, 4:7] = (1.0, 0.0, 2.0)  # every node sped up alike
    to_points(points, flip_fraction=1.0)
    assert points.velocity == pytest.approx(noisy + np.array([1.0, 0.0, 2.0]), abs=1e-12)


@DIMS
def test_stress_does_work_where_the_gradient_says(dim: int) -> None:
    """The force is the transpose of the velocity gradient: power on the grid = stress power of the points."""
    points = make_points(dim, stressed=True)
    points.affine[:] = 0
    dt = 1e-3
    to_grid(points, dt=dt)
    impulse = points.grid[:, 4:7].copy()
    pressure = np.maximum(points.stress[:, 6], -50.0)
    stress = points.stress.copy()
    velocity = np.random.default_rng(2).normal(size=(len(points.grid), 3)) * (1, dim - 2, 1)
    points.grid[:] = 0
    points.grid[:, :3] = velocity
    to_points(points, flip_fraction=0.0)
    gradient = points.affine.reshape(-1, 3, 3)
    cauchy = np.empty_like(gradient)
    for (a, b), column in {(0, 0): 0, (1, 1): 1, (2, 2): 2, (0, 1): 3, (1, 2): 4, (2, 0): 5}.items():
        cauchy[:, a, b] = cauchy[:, b, a] = stress[:, column]
    cauchy -= pressure[:, None, None] * np.eye(3)
    power = (points.volume[:, None, None] * cauchy * gradient).sum()
    assert (impulse * velocity).sum() == pytest.approx(-dt * power, rel=1e-11)


def test_the_gap_of_a_wall_node_is_that_of_the_nearest_point() -> None:
    points = make_points(2, number=2)
    points.position[:] = [[2.5, 0, 0.3], [2.6, 0, 1.2]]
    to_grid(points)
    nz = points.nodes[2]
    assert points.gap[2 * nz, 2] == pytest.approx(0.3)
    assert points.gap[0, 2] == np.inf
    assert points.gap[2 * nz + points.cells[2], 2] == np.inf


def test_coordinates_stay_inside_and_nan_does_not_become_an_address() -> None:
    assert keep_inside(-0.5, 5) == (WALL_MARGIN, 1)
    assert keep_inside(5.1, 5) == (5 - WALL_MARGIN, 1)
    assert keep_inside(5.0, 5) == (5 - WALL_MARGIN, 0)
    assert keep_inside(2.5, 5) == (2.5, 0)
    assert keep_inside(0.5 * WALL_MARGIN, 5) == (WALL_MARGIN, 0)
    assert keep_inside(float("nan"), 5) == (WALL_MARGIN, 1)
