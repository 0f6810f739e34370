"""A setting on the figures of speed against accuracy: what is known of it, its mark, its name, and axes for both."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gns_pl.viz.labels import Label, write_labels

GROUPS = {
    "mpm": ("MPM, cells of 1/N", "#0072B2", "o"),
    "retuned": ("retuned MPM", "#882255", "P"),
    "shallow": ("depth-averaged", "#E69F00", "h"),
    "learned": ("learned", "#D55E00", "s"),
    "corrected": ("corrected MPM", "#009E73", "D"),
    "hybrid": ("hybrid", "#CC79A7", "v"),
    "extrapolated": ("two MPM extrapolated", "#56B4E9", "x"),
    "law": ("law of runout", "#000000", "+"),
    "trivial": ("trivial", "#777777", "^"),
    "other": ("other solvers", "#000000", "*"),
}
"""Group → legend, colour (Okabe and Ito's, one of Tol's), marker. A group that is not here is drawn as "other"."""

ASIDE = ("law", "trivial")
"""Groups that take no time worth the name: outside of the headline, at the left edge of the details."""

RADIUS = 3.2
"""Of a mark [pt]."""

LEAST = 2e-3
"""Errors are drawn as at least this, for the axes are logarithmic."""


@dataclass(frozen=True)
class Mark:
    """A setting.

    Attributes:
        name: of the setting.
        group: in `GROUPS`, or another.
        seconds: wall time of a scene [s].
        low: of the fastest run.
        high: of the slowest.
        errors: measure → relative error; a panel leaves out an infinite one, of what failed or gives none.
        label: written beside it; "" for none.
        whole: in three dimensions, drawn hollow.
        on_fronts: measures by which it is a point of the Pareto front.
        spent: on data and training before [s]; NaN where unknown or nothing.
        pays: break-even number of scenes in words.
    """

    name: str
    group: str
    seconds: float
    low: float
    high: float
    errors: Mapping[str, float]
    label: str
    whole: bool
    on_fronts: Collection[str]
    spent: float
    pays: str

    @property
    def drawn_as(self) -> str:
        """The group as which it is drawn."""
        return self.group if self.group in GROUPS else "other"


def marker_style(group: str, *, whole: bool = False) -> dict[str, Any]:
    """Return matplotlib's arguments for the mark of a group of `GROUPS`, hollow if in three dimensions."""
    _, colour, marker = GROUPS[group]
    size = 2 * RADIUS * {"D": 0.85, "*": 1.4, "P": 1.15, "h": 1.15}.get(marker, 1.0)
    style = {"color": colour, "marker": marker, "markersize": size, "linestyle": "none", "markeredgewidth": 0.5}
    if marker in "x+":
        return style | {"markeredgewidth": 1.4}
    if whole:
        return style | {"markerfacecolor": "white", "markeredgewidth": 1.1}
    return style | {"markeredgecolor": "white"}


def shortened(label: str) -> str:
    """Return a name as it is written in a figure: `mpm_10.2_c0.6` as 1/10.2 c0.6, for the legend says what it is."""
    return "1/" + label.removeprefix("mpm_").replace("_", " ") if re.match(r"mpm_\d", label) else label


def write_names(
    axes: Any,
    named: Iterable[tuple[str, tuple[float, float], str]],
    marks: Iterable[tuple[float, float]],
    lines: Sequence[Any],
    size: float,
) -> None:
    """Write names beside their marks.

    Args:
        axes: with their final limits.
        named: label, place and group of each.
        marks: places of all marks.
        lines: start and end of the lines that names should not lie on.
        size: of the font [pt].
    """
    from matplotlib.colors import to_rgb

    labels = []
    for text, place, group in named:
        red, green, blue = (0.72 * part for part in to_rgb(GROUPS[group][1]))  # pale letters are hard to read
        labels.append(Label(shortened(text), place, (red, green, blue)))
    ends = np.array(lines, dtype=float).reshape(-1, 2, 2)
    write_labels(axes, labels, marks=np.array(list(marks)), lines=ends, size=size, radius=RADIUS)


def number_axes(axes: Any, *, percent: bool = True) -> None:
    """Plain numbers at 1, 2 and 5 of every decade, or at 1 alone where it has many."""
    for axis, (low, high), unit in ((axes.xaxis, axes.get_xlim(), False), (axes.yaxis, axes.get_ylim(), percent)):
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
        steps = (1, 2, 5) if math.log10(high / low) < 2.6 else (1,)
        ticks = [step * 10.0**decade for decade in decades for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        axis.set_ticks(ticks, [f"{100 * tick:g} %" if unit else f"{tick:g}" for tick in ticks])
        minor = [step * 10.0**decade for decade in decades for step in range(1, 10)]
        axis.set_ticks([tick for tick in minor if low <= tick <= high and tick not in ticks], minor=True)
        axis.set_minor_formatter("")
        axis.set_tick_params(which="minor", length=1.5, width=0.4)
        axis.grid(which="major", alpha=0.3, linewidth=0.4)
