"""Numbers in the names of files: a trajectory has one time between frames, so that they have to follow evenly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

from gns_pl.errors import InputError

LISTED = 5
"""Numbers that a message names."""


def even_step(numbers: Sequence[int], what: str) -> int | None:
    """Return the distance of the numbers of a series; None if there is one number alone.

    Args:
        numbers: at least one, rising.
        what: the series, for the message.

    Raises:
        InputError: numbers are missing, or come between the others; they are named.
    """
    steps = [after - before for before, after in pairwise(numbers)]
    if not steps:
        return None
    counts = Counter(steps)
    step = min(steps, key=lambda each: (-counts[each], each))
    missing: list[int] = []
    number = 0
    for before, after in pairwise(numbers):
        if (after - before) % step:
            raise InputError(
                f"{what}: its numbers do not follow evenly: after {before} comes {after} and not {before + step}; two "
                "series may be mixed here, or saved at other times: leave one time between frames."
            )
        gap = (after - before) // step - 1
        number += gap
        missing += [before + step * (k + 1) for k in range(min(gap, LISTED - len(missing)))]
    if number:
        are = "is" if number == 1 else "are"
        raise InputError(
            f"{what}: its numbers do not follow evenly by {step}: {listed(missing, number)} {are} missing; put back "
            "what is missing, or convert what is before and behind it from folders of their own."
        )
    return step


def listed(values: Sequence[object], number: int | None = None) -> str:
    """Return the first values of a list and how many more there are."""
    number = len(values) if number is None else number
    shown = ", ".join(str(each) for each in values[:LISTED])
    return f"{shown} and {number - LISTED} more" if number > LISTED else shown
