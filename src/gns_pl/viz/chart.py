"""The chart of speed against accuracy: errors over time, throughput of batches, error over what was spent before."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.viz.plots import STYLE

GROUPS = {
    "mpm": ("MPM", "#0072B2", "o"),
    "learned": ("learned", "#D55E00", "s"),
    "corrected": ("corrected MPM", "#009E73", "D"),
    "retuned": ("MPM fitted to fine MPM", "#882255", "P"),
    "hybrid": ("hybrid", "#CC79A7", "v"),
    "shallow": ("depth-averaged", "#8B4513", "h"),
    "extrapolated": ("two MPM runs extrapolated", "#56B4E9", "x"),
    "law": ("law of the aspect ratio (microseconds)", "#E69F00", "+"),
    "trivial": ("trivial", "#777777", "^"),
    "other": ("other solvers", "#000000", "P"),
}
"""Group → legend, colour (Okabe and Ito's), marker. A group that is not here is drawn as "other"."""

LEAST, SOON = 2e-3, 2e-4
"""Errors are drawn as at least this; what takes less time [s] is drawn at this, for the axes are logarithmic."""


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


def plot_chart(
    marks: Sequence[Mark],
    rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]],
    *,
    bands: Mapping[str, float],
    measures: Mapping[str, str],
    title: str,
    caption: str,
    paths: Sequence[Path],
) -> None:
    """Draw a panel for each measure, the last one large, two for throughput and costs, and the text under them.

    Args:
        marks: settings.
        rates: name → group, and batch and scenes per second of every size.
        bands: measure → uncertainty of the reference, relative, as a grey band.
        measures: in words, the one by which all is summed up the last.
        title: over all.
        caption: under all; wrapped.
        paths: files to write; the ending says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    lines = textwrap.wrap(caption, 175)
    *others, last = measures
    with mpl.rc_context(STYLE):
        below = 0.62 + 0.16 * len(lines)
        figure = Figure(figsize=(11.0, 12.2 + below))
        grid = figure.add_gridspec(
            3, 2, height_ratios=(1.35, 1, 0.8), hspace=0.22, wspace=0.16, left=0.07, right=0.985,
            bottom=(below + 0.2) / figure.get_figheight(), top=1 - 0.95 / figure.get_figheight(),
        )  # fmt: skip
        main, rate_axes, cost_axes = (figure.add_subplot(grid[place]) for place in ((0, slice(None)), (2, 0), (2, 1)))
        _draw_front(main, marks, last, bands[last], measures[last])
        for number, measure in enumerate(others):
            _draw_front(figure.add_subplot(grid[1, number]), marks, measure, bands[measure], measures[measure])
        _draw_rates(rate_axes, rates)
        _draw_costs(cost_axes, [mark for mark in marks if mark.spent > 0], last)
        figure.suptitle(title, fontsize=9, y=1 - 0.12 / figure.get_figheight(), va="top")
        handles, texts = main.get_legend_handles_labels()
        place = 0.5, 1 - 0.3 / figure.get_figheight()
        figure.legend(handles, texts, loc="upper center", bbox_to_anchor=place, ncols=5, fontsize=7, frameon=False)
        figure.text(0.06, 0.012, "\n".join(lines), fontsize=7, va="bottom", ha="left")
        for path in paths:
            figure.savefig(path)


def shown_group(mark: Mark) -> str:
    """Return the group as which a setting is drawn."""
    return mark.group if mark.group in GROUPS else "other"


def _draw_front(axes: Any, every: Sequence[Mark], measure: str, band: float, words: str) -> None:
    axes.axhspan(
        LEAST / 2, max(band, LEAST / 2), color="0.92", linewidth=0, zorder=-2, label="the reference's own uncertainty"
    )
    marks = [mark for mark in every if np.isfinite(mark.errors[measure])]
    named: list[tuple[str, tuple[float, float], str]] = []
    for group, (legend, colour, marker) in GROUPS.items():
        own = sorted((mark for mark in every if shown_group(mark) == group), key=lambda mark: mark.seconds)
        if own:  # in every panel, so that the legend of one is that of all
            face = {} if marker in "x+" else {"markerfacecolor": colour}
            axes.plot([], [], color=colour, marker=marker, markersize=5, linestyle="none", label=legend, **face)
        for mark in own:
            if mark not in marks:
                continue
            place = max(mark.seconds, SOON), max(mark.errors[measure], LEAST)
            named.append((mark.label, place, colour))
            bars = [[max(0.0, mark.seconds - mark.low)], [max(0.0, mark.high - mark.seconds)]]
            face = {} if marker in "x+" else {"markerfacecolor": "none" if mark.whole else colour}
            axes.errorbar(
                *place, xerr=bars, color=colour, marker=marker, markersize=5, elinewidth=0.6, linestyle="none", **face
            )
    front = sorted((mark for mark in marks if measure in mark.on_fronts), key=lambda mark: mark.seconds)
    if front:
        places = [(max(mark.seconds, SOON), max(mark.errors[measure], LEAST)) for mark in front]
        axes.step(
            *zip(*places, strict=True), where="post", color="black", linewidth=0.8, label="Pareto front", zorder=0
        )
    axes.set(xscale="log", yscale="log", xlabel="time of a scene [s]")
    axes.set_title(f"error: {words}", fontsize=8)
    _percent_axis(axes)
    axes.set_ylim(bottom=0.8 * max(LEAST, min([band, *(mark.errors[measure] for mark in marks)])))
    axes.grid(alpha=0.25, linewidth=0.4)
    if marks:
        axes.set_xlim(right=3 * max(mark.seconds for mark in marks))
        _write_names(axes, named)


def _draw_rates(axes: Any, rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]]) -> None:
    named: list[tuple[str, tuple[float, float], str]] = []
    for name, (group, points) in rates.items():
        _, colour, marker = GROUPS.get(group, GROUPS["other"])
        sizes, speeds = zip(*sorted(points), strict=True)
        axes.plot(sizes, speeds, color=colour, marker=marker, markersize=3, linewidth=0.8)
        named.append((name, (sizes[-1], speeds[-1]), colour))
    every = sorted({size for _, points in rates.values() for size, _ in points})
    axes.set(yscale="log", xlabel="scenes at once", ylabel="scenes per second")
    if every:
        axes.set_xscale("log", base=2)
        axes.set_xticks(every, [str(size) for size in every])
        axes.set_xlim(right=every[-1] * 4)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
        _write_names(axes, sorted(named, key=lambda mark: mark[1][1]), right=True)
    else:
        axes.set_title("throughput was not measured")
    axes.grid(alpha=0.25, linewidth=0.4)


def _draw_costs(axes: Any, every: Sequence[Mark], measure: str) -> None:
    marks = [mark for mark in every if np.isfinite(mark.errors[measure])]
    named: list[tuple[str, tuple[float, float], str]] = []
    for mark in marks:
        _, colour, marker = GROUPS[shown_group(mark)]
        place = mark.spent, max(mark.errors[measure], LEAST)
        axes.plot(*place, color=colour, marker=marker, markersize=4, linestyle="none")
        named.append((f"{mark.name}: {mark.pays}", place, colour))
    axes.set(yscale="log", xlabel="spent on data and training [s] (: scenes until it has paid)", ylabel="error")
    if marks:
        axes.set_xscale("log")
        axes.set_xlim(right=60 * max(mark.spent for mark in marks))
        _percent_axis(axes)
        _write_names(axes, named)
    else:
        axes.set_title("nothing is known to have been spent")
    axes.grid(alpha=0.25, linewidth=0.4)


def _percent_axis(axes: Any) -> None:
    low, high = axes.get_ylim()
    ticks = [tick for tick in (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0) if low <= tick <= high]
    axes.set_yticks(ticks, [f"{100 * tick:g} %" for tick in ticks])
    axes.minorticks_off()
    axes.set_ylim(low, high)


def _write_names(axes: Any, named: Sequence[tuple[str, tuple[float, float], str]], *, right: bool = False) -> None:
    """Write names beside their places, each where it covers no earlier one and no mark, as far as there is room.

    Args:
        axes: with their final limits.
        named: text, place and colour of each.
        right: only to the right of the places, in their order from below.
    """
    size = 5.5
    to_points = 72 / axes.figure.dpi
    spots = [tuple(to_points * axes.transData.transform(place)) for _, place, _ in named]
    taken = [(x - 3, y - 3, x + 3, y + 3) for x, y in spots]
    low, high = (to_points * axes.transAxes.transform((end, end))[0] for end in (0, 1))
    sides = ((-1e4, -1e4, low, 1e4), (high, -1e4, 1e4, 1e4))
    for (name, place, colour), (x, y) in zip(named, spots, strict=True):
        width, height, boxes = 0.56 * size * len(name), 1.1 * size, []
        lifts = range(0, 90, 6) if right else (4, -4, 10, -10, 16, -16, 22, -22, 28, -28)
        for lift in lifts:
            for left in (4.0 + lift / 4,) if right else (4.0, -4.0 - width):
                boxes.append((x + left, y + lift - height / 2, x + left + width, y + lift + height / 2))
        # What lies outside of the axes' sides counts as covered.
        box = min(boxes, key=lambda candidate: sum(_overlap(candidate, other) for other in (*taken, *sides)))
        taken.append(box)
        offset = box[0] - x, (box[1] + box[3]) / 2 - y
        axes.annotate(
            name, place, xytext=offset, textcoords="offset points", fontsize=size, color=colour, va="center",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.3} if abs(offset[1]) > 8 else None,
        )  # fmt: skip


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    across = min(one[2], other[2]) - max(one[0], other[0])
    return max(0.0, across) * max(0.0, min(one[3], other[3]) - max(one[1], other[1]))
