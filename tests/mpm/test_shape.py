from __future__ import annotations

import numpy as np
import pytest

from gns_pl.mpm.shape import WALL_REACH, approach_wall, axis_shape

CELLS = (2, 3, 7)


def shapes(num_cells: int) -> list[tuple[float, np.ndarray, np.ndarray, np.ndarray, float]]:
    """Place of action, nodes, weights, gradients and second moment for points everywhere, at walls and knots too."""
    places = np.concatenate([np.linspace(0, num_cells, 201), np.arange(num_cells + 1), np.arange(num_cells) + 0.5])
    found = []
    for x in places:
        base, *values, moment = axis_shape(float(x), num_cells)
        acting = min(max(float(x), WALL_REACH), num_cells - WALL_REACH)
        found.append((acting, base + np.arange(3), np.array(values[:3]), np.array(values[3:]), moment))
    return found


@pytest.mark.parametrize("num_cells", CELLS)
def test_weights_are_a_partition_of_unity(num_cells: int) -> None:
    for _, nodes, weights, gradients, _ in shapes(num_cells):
        assert weights.sum() == pytest.approx(1, abs=1e-14)
        assert gradients.sum() == pytest.approx(0, abs=1e-13)
        assert (weights >= -1e-15).all()
        assert nodes[0] >= 0
        assert nodes[-1] <= num_cells


@pytest.mark.parametrize("num_cells", CELLS)
def test_linear_fields_are_exact_with_their_gradient(num_cells: int) -> None:
    for x, nodes, weights, gradients, _ in shapes(num_cells):
        assert weights @ nodes == pytest.approx(x, abs=1e-13)
        assert gradients @ nodes == pytest.approx(1, abs=1e-13)


@pytest.mark.parametrize("num_cells", CELLS)
def test_gradient_and_second_moment_belong_together(num_cells: int) -> None:
    for x, nodes, weights, gradients, moment in shapes(num_cells):
        assert weights * (nodes - x) == pytest.approx(moment * gradients, abs=1e-13)
        assert weights @ (nodes - x) ** 2 == pytest.approx(moment, abs=1e-13)


@pytest.mark.parametrize("num_cells", CELLS)
def test_weights_and_gradients_have_no_jumps(num_cells: int) -> None:
    fine = np.linspace(0, num_cells, 4001)
    dense = np.zeros((len(fine), 2, num_cells + 1))
    for row, x in zip(dense, fine, strict=True):
        base, *values, _ = axis_shape(float(x), num_cells)
        row[:, base : base + 3] = np.array(values).reshape(2, 3)
    assert np.abs(np.diff(dense, axis=0)).max() < 10 * num_cells / 4000


@pytest.mark.parametrize("num_cells", CELLS)
def test_no_gradient_is_steeper_for_its_weight_than_in_the_interior(num_cells: int) -> None:
    for _, _, weights, gradients, _ in shapes(num_cells):
        assert (np.abs(gradients) <= 6 * weights + 1e-12).all()


def test_half_a_cell_from_a_wall_the_splines_become_hats() -> None:
    assert axis_shape(0.3, 5) == pytest.approx((0, 0.7, 0.3, 0.0, -1.0, 1.0, 0.0, 0.21))
    assert axis_shape(4.7, 5) == pytest.approx((3, 0.0, 0.3, 0.7, 0.0, -1.0, 1.0, 0.21))


@pytest.mark.parametrize("start", [0.01, 0.1, 0.3])
def test_a_point_comes_to_a_wall_but_never_through(start: float) -> None:
    """The nodes at the wall rest, the inner ones rush towards it at half a cell a step."""
    low, high = start, 5 - start
    for _ in range(20):
        low = approach_wall(low, -0.5 * max(low, WALL_REACH), 5)
        high = approach_wall(high, 0.5 * max(5 - high, WALL_REACH), 5)
        assert low > 0
        assert high < 5
    assert low < start * 0.6
    assert approach_wall(0.01, 0.2, 5) == pytest.approx(0.21)  # nothing keeps it from leaving


def test_the_interior_is_the_quadratic_b_spline() -> None:
    base, *weights = axis_shape(2.8, 5)[:4]
    assert base == 2
    assert weights == pytest.approx([0.5 * 0.7**2, 0.75 - 0.2**2, 0.5 * 0.3**2])
