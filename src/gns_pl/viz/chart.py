"""The chart of speed against accuracy: error over time, throughput of batches, error over what was spent before."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
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
    "hybrid": ("handed over", "#CC79A7", "v"),
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
        error: relative; settings that failed, with an infinite one, are left out.
        label: written beside it; "" for none.
        whole: in three dimensions, drawn hollow.
        on_front: a point of the front.
        spent: on data and training before [s]; NaN where unknown or nothing.
        pays: break-even number of scenes in words.
    """

    name: str
    group: str
    seconds: float
    low: float
    high: float
    error: float
    label: str
    whole: bool
    on_front: bool
    spent: float
    pays: str


def plot_chart(
    marks: Sequence[Mark],
    rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]],
    *,
    band: float,
    title: str,
    caption: str,
    paths: Sequence[Path],
) -> None:
    """Draw the three panels and the text under them.

    Args:
        marks: settings.
        rates: name → group, and batch and scenes per second of every size.
        band: uncertainty of the reference, relative, as a grey band.
        title: over all.
        caption: under all; wrapped.
        paths: files to write; the ending says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    lines = textwrap.wrap(caption, 175)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 5.2 + 0.16 * len(lines)))
        bottom = (0.62 + 0.16 * len(lines)) / figure.get_figheight()
        grid = figure.add_gridspec(2, 2, width_ratios=(2.1, 1), hspace=0.42, wspace=0.2, left=0.06, right=0.985)
        grid.update(bottom=bottom + 0.02, top=0.92)
        main, above, below = (figure.add_subplot(cell) for cell in (grid[:, 0], grid[0, 1], grid[1, 1]))
        _draw_front(main, [mark for mark in marks if np.isfinite(mark.error)], band)
        _draw_rates(above, rates)
        _draw_costs(below, [mark for mark in marks if np.isfinite(mark.error) and mark.spent > 0])
        figure.suptitle(title, fontsize=9)
        figure.text(0.06, 0.012, "\n".join(lines), fontsize=7, va="bottom", ha="left")
        for path in paths:
            figure.savefig(path)


def shown_group(mark: Mark) -> str:
    """Return the group as which a setting is drawn."""
    return mark.group if mark.group in GROUPS else "other"


def _draw_front(axes: Any, marks: Sequence[Mark], band: float) -> None:
    axes.axhspan(
        LEAST / 2, max(band, LEAST / 2), color="0.92", linewidth=0, zorder=-2, label="the reference's own uncertainty"
    )
    named: list[tuple[str, tuple[float, float], str]] = []
    for group, (legend, colour, marker) in GROUPS.items():
        own = sorted((mark for mark in marks if shown_group(mark) == group), key=lambda mark: mark.seconds)
        for number, mark in enumerate(own):
            place = max(mark.seconds, SOON), max(mark.error, LEAST)
            named.append((mark.label, place, colour))
            bars = [[max(0.0, mark.seconds - mark.low)], [max(0.0, mark.high - mark.seconds)]]
            face = {} if marker in "x+" else {"markerfacecolor": "none" if mark.whole else colour}
            axes.errorbar(
                *place, xerr=bars, color=colour, marker=marker, markersize=5, elinewidth=0.6, linestyle="none",
                label=legend if number == 0 else None, **face,
            )  # fmt: skip
    front = sorted((mark for mark in marks if mark.on_front), key=lambda mark: mark.seconds)
    if front:
        places = [(max(mark.seconds, SOON), max(mark.error, LEAST)) for mark in front]
        axes.step(
            *zip(*places, strict=True), where="post", color="black", linewidth=0.8, label="Pareto front", zorder=0
        )
    axes.set(xscale="log", yscale="log", xlabel="wall time of a scene [s]")
    axes.set_ylabel("error of the final 99 % runout, root mean square over scenes and placements")
    _percent_axis(axes)
    axes.set_ylim(bottom=0.8 * max(LEAST, min([band, *(mark.error for mark in marks)])))
    axes.grid(alpha=0.25, linewidth=0.4)
    axes.set_xlim(right=3 * max(mark.seconds for mark in marks))
    axes.legend(loc="center left", bbox_to_anchor=(0.04, 0.4), fontsize=6)
    _write_names(axes, named)


def _draw_rates(axes: Any, rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]]) -> None:
    named: list[tuple[str, tuple[float, float], str]] = []
    for name, (group, points) in rates.items():
        _, colour, marker = GROUPS[group]
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


def _draw_costs(axes: Any, marks: Sequence[Mark]) -> None:
    named: list[tuple[str, tuple[float, float], str]] = []
    for mark in marks:
        _, colour, marker = GROUPS[mark.group]
        place = mark.spent, max(mark.error, LEAST)
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
    for (name, place, colour), (x, y) in zip(named, spots, strict=True):
        width, height, boxes = 0.56 * size * len(name), 1.1 * size, []
        lifts = range(0, 90, 6) if right else (4, -4, 10, -10, 16, -16, 22, -22, 28, -28)
        for lift in lifts:
            for left in (4.0 + lift / 4,) if right else (4.0, -4.0 - width):
                boxes.append((x + left, y + lift - height / 2, x + left + width, y + lift + height / 2))
        box = min(boxes, key=lambda candidate: sum(_overlap(candidate, other) for other in taken))
        taken.append(box)
        offset = box[0] - x, (box[1] + box[3]) / 2 - y
        axes.annotate(
            name, place, xytext=offset, textcoords="offset points", fontsize=size, color=colour, va="center",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.3} if abs(offset[1]) > 8 else None,
        )  # fmt: skip


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    across = min(one[2], other[2]) - max(one[0], other[0])
    return max(0.0, across) * max(0.0, min(one[3], other[3]) - max(one[1], other[1]))
