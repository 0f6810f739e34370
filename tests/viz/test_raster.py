"""Grains in pixels."""

import numpy as np
import pytest

from gns_pl.viz.raster import View, displacement, displacement_limit, draw_grains, side_window
from tests.evaluation.made_up import SPACING, moved, spreading, standing

VIEW = View((0.0, 0.0), (1.0, 0.5), 200)


def test_shape_of_a_view() -> None:
    assert VIEW.shape == (100, 200)


def test_a_grain_covers_its_disc_where_it_is() -> None:
    values, shades = draw_grains(np.array([[0.2525, 0.0, 0.3975]]), np.array([3.0]), VIEW, 0.1)
    rows, columns = np.nonzero(np.isfinite(values))
    assert len(rows) == pytest.approx(np.pi * 10**2, rel=0.05)
    assert rows.mean() == pytest.approx(20, abs=0.5) and columns.mean() == pytest.approx(50, abs=0.5)
    assert np.all(values[rows, columns] == 3)
    assert 0 < np.nanmin(shades) < np.nanmax(shades) <= 1


def test_the_nearer_grain_hides_the_farther_one() -> None:
    position = np.array([[0.5, 0.1, 0.25], [0.5, 0.4, 0.25]])
    for order in ([0, 1], [1, 0]):
        values, _ = draw_grains(position[order], np.array([1.0, 2.0])[order], VIEW, 0.1)
        assert set(values[np.isfinite(values)]) == {1.0}


def test_grains_outside_the_window_are_left_out() -> None:
    position = np.array([[-5.0, 0.0, 0.2], [0.5, 0.0, 1e12], [1.0, 0.0, 0.2]])
    values, _ = draw_grains(position, np.arange(3.0), VIEW, 0.1)
    assert set(values[np.isfinite(values)]) == {2.0}


def test_two_dimensions() -> None:
    values, _ = draw_grains(np.array([[0.5, 0.25]]), np.ones(1), VIEW, 0.1)
    assert np.isfinite(values[50, 100])


def test_window_shows_the_highest_grain_and_ends_at_the_box() -> None:
    lower, upper = side_window([standing()], SPACING)
    assert lower == (0, 0) and upper[0] == 1.5
    assert 0.2 < upper[1] < 0.3
    assert side_window([standing(), moved(standing(), np.full((5, 3), 9.0))], SPACING)[1][1] == 0.7


def test_displacement_and_its_scale() -> None:
    still = standing()
    pushed = moved(still, np.arange(5)[:, None] * [0.03, 0.04, 0])
    np.testing.assert_allclose(displacement(pushed, 2), 0.1, rtol=1e-4)
    assert displacement_limit(pushed) == pytest.approx(0.2, rel=1e-4)
    assert displacement_limit(still) > 0
    assert displacement_limit(spreading()) < 0.4
