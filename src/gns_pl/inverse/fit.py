"""Minimisers of a misfit: by its gradient, and by Gauss–Newton on the residuals of every place.

`lbfgs` and `adam` need a gradient, wherever it comes from; their price does not grow with the number of unknowns if
that is reverse mode. `solve` needs runs alone, of whatever solver, and more of them for every unknown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Bounds:
    """Where unknowns may lie; both work in units of this range, so that no unknown is steeper for its unit.

    Attributes:
        lower: of every unknown.
        upper: likewise.

    Raises:
        InputError: a range that is empty.
    """

    lower: Sequence[float]
    upper: Sequence[float]

    def __post_init__(self) -> None:
        if len(self.lower) != len(self.upper) or not all(
            low < high for low, high in zip(self.lower, self.upper, strict=True)
        ):
            raise InputError(f"every unknown needs a lower bound below its upper: {self.lower} and {self.upper}.")

    @property
    def extent(self) -> Floats:
        """Upper less lower."""
        return np.subtract(self.upper, self.lower, dtype=np.float64)

    def inside(self, share: Floats) -> Floats:
        """Return unknowns from their shares of the range, cut to it."""
        return np.asarray(np.asarray(self.lower) + np.clip(share, 0, 1) * self.extent)

    def share(self, unknowns: Sequence[float]) -> Floats:
        """Return the shares of the range, the inverse of `inside`."""
        return np.asarray((np.asarray(unknowns, dtype=np.float64) - np.asarray(self.lower)) / self.extent)


@dataclass(frozen=True)
class Fit:
    """What came out.

    Attributes:
        unknowns: with the least misfit.
        misfit: there.
        evaluations: of the misfit, each with its gradient where there is one.
        seconds: of the wall clock.
        cpu_seconds: of the process, which are those of the wall clock where a thread has a core for itself.
        path: unknowns of every evaluation and their misfit [K, U + 1].
    """

    unknowns: Floats
    misfit: float
    evaluations: int
    seconds: float
    cpu_seconds: float
    path: Floats


def lbfgs(
    misfit: Callable[[Floats], tuple[float, Floats]],
    start: Sequence[float],
    bounds: Bounds,
    *,
    tolerance: float,
    most: int,
) -> Fit:
    """Minimise by L-BFGS-B (Byrd et al. 1995).

    Args:
        misfit: unknowns → misfit and gradient.
        start: unknowns to begin from.
        bounds: of the unknowns.
        tolerance: it ends when a step lowers the misfit by less than this share of the first.
        most: evaluations, about.
    """
    from scipy.optimize import minimize

    record = _Record()

    def scaled(share: Floats) -> tuple[float, Floats]:
        unknowns = bounds.inside(share)
        value, gradient = misfit(unknowns)
        record.add(unknowns, value)
        # From a misfit of order 1, so that the first step, as long as the gradient, is one within the range.
        return value / record.first, gradient * bounds.extent / record.first

    box = [(0.0, 1.0)] * len(start)
    options = {"maxfun": most, "ftol": tolerance, "gtol": 1e-9}
    minimize(scaled, bounds.share(start), jac=True, method="L-BFGS-B", bounds=box, options=options)
    return record.fit()


def adam(
    misfit: Callable[[Floats], tuple[float, Floats]], start: Sequence[float], bounds: Bounds, *, most: int, pace: float
) -> Fit:
    """Minimise by Adam (Kingma and Ba 2015), with a step length that falls to zero.

    Where a misfit is rough on a small scale it goes on where `lbfgs` finds no descent; it takes all its steps.

    Args:
        misfit: unknowns → misfit and gradient.
        start: unknowns to begin from.
        bounds: of the unknowns.
        most: evaluations.
        pace: length of the first step, a share of the range.
    """
    record, share = _Record(), bounds.share(start)
    mean, square = np.zeros(len(share)), np.zeros(len(share))
    for count in range(1, most + 1):
        unknowns = bounds.inside(share)
        value, gradient = misfit(unknowns)
        record.add(unknowns, value)
        slope = gradient * bounds.extent
        mean, square = 0.8 * mean + 0.2 * slope, 0.95 * square + 0.05 * slope**2
        step = mean / (1 - 0.8**count) / (np.sqrt(square / (1 - 0.95**count)) + 1e-12)
        share = np.clip(share - pace * (1 - count / (most + 1)) * step, 0, 1)
    return record.fit()


def solve(
    residual: Callable[[Floats], Floats],
    start: Sequence[float],
    bounds: Bounds,
    *,
    difference: float,
    tolerance: float,
    most: int,
) -> Fit:
    """Solve the least squares by Gauss–Newton in a trust region, with differences (Branch, Coleman and Li 1999).

    What each place tells is used, and not their sum alone; for few unknowns it is the cheapest.

    Args:
        residual: unknowns → [P], of which the misfit is the sum of squares.
        start: unknowns to begin from.
        bounds: of the unknowns.
        difference: with which slopes are measured, a share of the range.
        tolerance: it ends when a step is shorter than this share of the range, or gains less of the misfit.
        most: steps.
    """
    from scipy.optimize import least_squares

    record, known = _Record(), dict[bytes, Floats]()

    def scaled(share: Floats) -> Floats:
        if share.tobytes() not in known:  # the solver asks for the slopes where it has been
            unknowns = bounds.inside(share)
            known[share.tobytes()] = values = residual(unknowns)
            record.add(unknowns, float(values @ values))
        return known[share.tobytes()]

    def slopes(share: Floats) -> Floats:
        columns = []
        for axis, value in zip(np.eye(len(share)), share, strict=True):
            step = -difference if value + difference > 1 else difference  # never out of the range
            columns.append((scaled(share + step * axis) - scaled(share)) / step)
        return np.column_stack(columns)

    box = ([0.0] * len(start), [1.0] * len(start))
    settings = {"bounds": box, "xtol": tolerance, "ftol": tolerance, "max_nfev": most}
    least_squares(scaled, bounds.share(start), slopes, **settings)
    return record.fit()


class _Record:
    """What was evaluated, and since when."""

    def __init__(self) -> None:
        self.began = time.perf_counter(), time.process_time()
        self.points: list[Floats] = []
        self.values: list[float] = []

    @property
    def first(self) -> float:
        return self.values[0] or 1.0

    def add(self, unknowns: Floats, value: float) -> None:
        self.points.append(np.array(unknowns))
        self.values.append(float(value))

    def fit(self) -> Fit:
        values = np.array(self.values)
        best = int(np.nanargmin(values))
        path = np.column_stack([np.array(self.points), values])
        seconds, cpu_seconds = time.perf_counter() - self.began[0], time.process_time() - self.began[1]
        return Fit(self.points[best], float(values[best]), len(values), seconds, cpu_seconds, path)
