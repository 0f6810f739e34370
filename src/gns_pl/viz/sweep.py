"""The figure of a sweep: what came of every value of what was swept."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.viz.plots import STYLE

LINE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette; lines beyond the last begin again with other markers."""

MARKERS = "os^DvP"

DECADE = 8.0
"""Values that span more than this factor stand on a logarithmic axis."""


@dataclass(frozen=True)
class SweepPoint:
    """One job.

    Attributes:
        x: value of the parameter on the horizontal axis; text if it is not a number.
        line: what tells its line from the others; "" if there is one.
        values: name of a panel → its value; NaN and missing ones are left out.
    """

    x: float | str
    line: str
    values: Mapping[str, float]


def plot_sweep(points: Sequence[SweepPoint], panels: Mapping[str, str], x_label: str, paths: Sequence[Path]) -> None:
    """Draw one panel per measured value, two a row; jobs of equal `x` and `line` (seeds) as their mean and spread.

    Args:
        points: the jobs that have something to show.
        panels: name of a value → label of its axis.
        x_label: name of the parameter on the horizontal axis.
        paths: files to write; the ending says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    lines = list(dict.fromkeys(point.line for point in points))
    names = list(dict.fromkeys(point.x for point in points))
    numeric = all(not isinstance(point.x, str) for point in points)
    rows = (len(panels) + 1) // 2
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 2.4 * rows + 0.4), layout="constrained")
        grid = figure.subplots(rows, 2, squeeze=False)
        for axes, (panel, label) in zip(grid.flat, panels.items(), strict=False):
            for index, line in enumerate(lines):
                of_line = [point for point in points if point.line == line]
                _draw_line(axes, of_line, panel, None if numeric else names, index, line)
            axes.set(xlabel=x_label, ylabel=label)
            _dress_axis(axes, names, numeric)
        for axes in list(grid.flat)[len(panels) :]:
            axes.set_visible(False)
        if len(lines) > 1:
            handles, labels = grid[0, 0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper center", ncols=min(len(lines), 3))
        for path in paths:
            figure.savefig(path)


def _draw_line(
    axes: Any, points: Sequence[SweepPoint], panel: str, names: Sequence[Any] | None, index: int, label: str
) -> None:
    """Draw the mean over equal places, every job as a faint point, and a bar from the least to the greatest."""
    values_at: dict[float, list[float]] = defaultdict(list)
    for point in points:
        value = point.values.get(panel, np.nan)
        if np.isfinite(value):
            values_at[float(point.x if names is None else names.index(point.x))].append(value)
    places = sorted(values_at)
    mean = np.array([np.mean(values_at[place]) for place in places])
    below = mean - [min(values_at[place]) for place in places]
    above = [max(values_at[place]) for place in places] - mean
    colour = LINE_COLOURS[index % len(LINE_COLOURS)]
    marker = MARKERS[index // len(LINE_COLOURS) % len(MARKERS)]
    repeated = any(len(values) > 1 for values in values_at.values())
    axes.errorbar(
        places,
        mean,
        yerr=[below, above] if repeated else None,
        color=colour,
        marker=marker,
        markersize=4,
        linewidth=1.2,
        capsize=3,
        label=label,
    )
    if repeated:
        for place in places:
            axes.plot([place] * len(values_at[place]), values_at[place], marker, color=colour, markersize=3, alpha=0.4)


def _dress_axis(axes: Any, names: Sequence[Any], numeric: bool) -> None:
    if numeric:
        if min(names) > 0 and max(names) / min(names) > DECADE:
            axes.set_xscale("log")
        axes.set_xticks(sorted(names), [f"{name:.4g}" for name in sorted(names)], rotation=30 if len(names) > 5 else 0)
        axes.minorticks_off()
    else:
        axes.set_xticks(range(len(names)), [str(name) for name in names], rotation=20 if len(names) > 3 else 0)
        axes.margins(x=0.2)
    low, high = axes.get_ylim()
    low, high = min(0.0, low), max(0.0, high)
    margin = 0.06 * (high - low)
    axes.set_ylim(low - margin if low < 0 else 0, high + margin if high > 0 else 0)
