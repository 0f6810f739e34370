"""Who beats whom: plain functions of seconds and errors, which know nothing of what was measured.

"Better" is always less: of seconds, and of error. A solver that comes in many sizes is a line of points, and between
two of them it is taken to follow a power law.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple


class Setting(NamedTuple):
    """A name at a place of the chart.

    Attributes:
        name: of the setting.
        seconds: wall time of a scene [s].
        error: relative; infinite if a run failed.
    """

    name: str
    seconds: float
    error: float


def pareto_front(spots: Sequence[Setting]) -> list[Setting]:
    """Return the spots that no other one beats, the fastest first.

    One beats another if it is no slower and no less accurate, and better in one of the two. What failed is on no front.
    """
    front: list[Setting] = []
    for spot in sorted((each for each in spots if math.isfinite(each.error)), key=lambda each: each[1:]):
        if not front or spot.error < front[-1].error or spot[1:] == front[-1][1:]:
            front.append(spot)
    return front


def fastest_as_good(spots: Sequence[Setting], error: float) -> Setting | None:
    """Return the fastest spot whose error is no larger; None if none is as good."""
    return min((each for each in spots if each.error <= error), key=lambda each: each[1:], default=None)


def best_as_fast(spots: Sequence[Setting], seconds: float) -> Setting | None:
    """Return the most accurate spot that takes no longer; None if none is as fast, or all that are failed."""
    known = [each for each in spots if each.seconds <= seconds and math.isfinite(each.error)]
    return min(known, key=lambda each: (each.error, each.seconds), default=None)


def seconds_of_error(line: Sequence[Setting], error: float) -> float:
    """Return the time that a line of settings takes for an error [s], along its own Pareto front.

    Between two settings log t is linear in log error. An error larger than that of the fastest setting costs what that
    one costs, since there is no faster; infinite where no setting is as accurate.

    Args:
        line: settings of one solver.
        error: relative, above 0.
    """
    front = pareto_front(line)
    if not front or error < front[-1].error:
        return math.inf
    for coarse, fine in pairwise(front):
        if error >= coarse.error:
            return coarse.seconds
        if error >= fine.error:
            if fine.error <= 0 or fine.error == coarse.error:
                return fine.seconds
            share = math.log(coarse.error / error) / math.log(coarse.error / fine.error)
            return coarse.seconds * math.exp(share * math.log(fine.seconds / coarse.seconds))
    return front[-1].seconds


def break_even(spent: float, seconds_other: float, seconds_own: float) -> float:
    """Return the number of scenes from which on an investment pays, N* = spent / (t_other − t_own).

    Args:
        spent: on data and training [s]; NaN if it is not known.
        seconds_other: what a scene takes of equal accuracy without it [s]; infinite if nothing is as accurate.
        seconds_own: what a scene takes with it [s].

    Returns:
        Infinite ("never") where the other is as fast; 0 where nothing else is as accurate at any price.
    """
    if not seconds_other > seconds_own:
        return math.inf
    return spent / (seconds_other - seconds_own)
