"""Both ways find the bottom of what has one, and stay where they may."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.inverse import Bounds, adam, lbfgs, solve

BOUNDS = Bounds((0.0, -2.0), (1.0, 2.0))


def residual(unknowns: np.ndarray) -> np.ndarray:
    return np.array([unknowns[0] - 0.3, 0.5 * (unknowns[1] + 1.0), 0.1 * (unknowns[0] - 0.3) * unknowns[1]])


def misfit(unknowns: np.ndarray) -> tuple[float, np.ndarray]:
    here = residual(unknowns)
    slope = np.array([[1.0, 0.0], [0.0, 0.5], [0.1 * unknowns[1], 0.1 * (unknowns[0] - 0.3)]])
    return float(here @ here), 2 * here @ slope


def test_both_find_it() -> None:
    down = lbfgs(misfit, (0.9, 1.5), BOUNDS, tolerance=1e-12, most=100)
    solved = solve(residual, (0.9, 1.5), BOUNDS, difference=0.01, tolerance=1e-8, most=50)
    for fit in (down, solved):
        np.testing.assert_allclose(fit.unknowns, [0.3, -1.0], atol=1e-4)
        assert fit.path.shape == (fit.evaluations, 3) and fit.seconds > 0
        assert fit.misfit == fit.path[:, -1].min()


def test_what_lies_outside_is_found_at_the_bound() -> None:
    narrow = Bounds((0.5, -2.0), (1.0, 2.0))
    down = lbfgs(misfit, (0.9, 1.5), narrow, tolerance=1e-12, most=100)
    solved = solve(residual, (0.9, 1.5), narrow, difference=0.01, tolerance=1e-8, most=50)
    for fit in (down, solved):
        assert fit.unknowns[0] == pytest.approx(0.5, abs=1e-3)
        assert (fit.path[:, 0] >= 0.5).all() and (fit.path[:, 0] <= 1.0).all()


def test_adam_ends_near_it() -> None:
    fit = adam(misfit, (0.9, 1.5), BOUNDS, most=60, pace=0.1)
    np.testing.assert_allclose(fit.unknowns, [0.3, -1.0], atol=0.02)
    assert fit.evaluations == 60


def test_slopes_are_measured_once() -> None:
    calls: list[bytes] = []

    def counted(unknowns: np.ndarray) -> np.ndarray:
        calls.append(unknowns.tobytes())
        return residual(unknowns)

    fit = solve(counted, (1.0, 2.0), BOUNDS, difference=0.01, tolerance=1e-6, most=50)
    assert len(calls) == len(set(calls)) == fit.evaluations


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(InputError, match="lower bound below"):
        Bounds((0.0, 1.0), (1.0, 1.0))
