"""What a set says as a whole, where each of its trajectories says something of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.convert.formats.source import Stated
from gns_pl.errors import InputError

SAME_TIME = 1e-6
SAME_SPACING = 0.05
"""Relative differences up to which two times, two spacings are the same."""
MOST_NOTES = 8


def stated_of_all(path: Path, names: Sequence[str], recordings: Sequence[Stated]) -> Stated:
    """Return what holds for all trajectories of a set: the box around their boxes, and what they have in common.

    Args:
        path: of the set, for messages.
        names: of the trajectories.
        recordings: what is stated of each.

    Raises:
        InputError: different times between frames, or gravity along different axes, which no set can have.
    """
    known = [(name, one.dt) for name, one in zip(names, recordings, strict=True) if one.dt is not None]
    if known:
        low, high = min(known, key=lambda pair: pair[1]), max(known, key=lambda pair: pair[1])
        if high[1] > low[1] * (1 + SAME_TIME):
            raise InputError(
                f"{path}: its trajectories have different times between frames, {low[0]} {low[1]:g} s and {high[0]} "
                f"{high[1]:g} s; convert them one by one."
            )
    axes = {int(np.abs(one.gravity).argmax()) for one in recordings if one.gravity is not None and any(one.gravity)}
    if len(axes) > 1:
        raise InputError(f"{path}: gravity is along different axes in its trajectories; convert them one by one.")
    spacing, questions = _spacing([one.spacing for one in recordings if one.spacing is not None])
    notes = list(dict.fromkeys(note for one in recordings for note in one.notes))
    if len(notes) > MOST_NOTES:
        notes = [*notes[:MOST_NOTES], f"and {len(notes) - MOST_NOTES} notes more of this kind"]
    differing = [
        word
        for word, value in (
            ("box", lambda one: (one.lower, one.upper)),
            ("gravity", lambda one: one.gravity),
            ("density", lambda one: one.density),
            ("angle of friction", lambda one: one.friction_angle_deg),
        )
        if len({value(one) for one in recordings}) > 1
    ]
    if differing:
        notes.append(f"trajectories differ in {', '.join(differing)}; each keeps its own")
    boxes = [(one.lower, one.upper) for one in recordings]
    whole = all(lower is not None and upper is not None for lower, upper in boxes)
    return replace(
        recordings[0],
        dt=known[0][1] if known else None,
        lower=_corner([one.lower for one in recordings], min) if whole else None,
        upper=_corner([one.upper for one in recordings], max) if whole else None,
        gravity=recordings[0].gravity if all(one.gravity is not None for one in recordings) else None,
        spacing=spacing,
        density=_common(recordings, "density"),
        friction_angle_deg=_common(recordings, "friction_angle_deg"),
        questions=questions,
        notes=tuple(notes),
    )


def _spacing(known: Sequence[float]) -> tuple[float | None, dict[str, str]]:
    """Return the spacing of a set and what is asked: one connectivity radius serves one spacing only."""
    if known and max(known) > min(known) * (1 + SAME_SPACING):
        spacings = f"{min(known):g} to {max(known):g}"
        return None, {"spacing": f"its spacings are {spacings}: convert those of one spacing alone, or give spacing=…"}
    return (float(f"{np.median(known):.6g}") if known else None), {}


def _corner(corners: Sequence[tuple[float, ...] | None], outermost: Callable[..., float]) -> tuple[float, ...] | None:
    sized = [corner for corner in corners if corner is not None]
    if len({len(corner) for corner in sized}) > 1:
        return None  # two and three dimensions, which are refused by their positions
    return tuple(outermost(values) for values in zip(*sized, strict=True))


def _common(recordings: Sequence[Stated], name: str) -> Any:
    values = {getattr(one, name) for one in recordings}
    return values.pop() if len(values) == 1 else None
