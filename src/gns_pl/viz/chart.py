"""Figures of speed against accuracy: the headline over several sets of scenes, and the details of one set.

Both are as wide as a page, 6.5 inches, and their text is large enough to be read on a telephone of 360 pixels. The
legend stands above the panels. The page of the figure says the rest.
"""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.viz.marks import ASIDE, GROUPS, LEAST, Mark, marker_style, number_axes, shortened, write_names
from gns_pl.viz.plots import STYLE

HEADLINE = "worse"
"""The error of the headline, a key of `Mark.errors`: the worse of front and map."""

WIDTH, LEFT, RIGHT = 6.5, 0.82, 0.12
"""Width of a figure, and of its margins [inch]."""

TEXT, SMALL = 10.4, 8.5
"""Sizes of text, and of the names in the details [pt]: 10.4 pt of 6.5 inches are 8 of 360 pixels."""


@dataclass(frozen=True)
class Panel:
    """A set of scenes in the headline: title, settings, and relative uncertainty of the reference, a grey band."""

    title: str
    marks: Sequence[Mark]
    band: float


def plot_chart(panels: Sequence[Panel], paths: Sequence[Path], *, legend: bool = True) -> None:
    """Draw the headline: a panel under the other for each set of scenes, the worse of front and map over wall time.

    Names stand at the points of the Pareto front and at all solvers but plain MPM. What gives a runout alone, or takes
    no time, is left out.

    Args:
        panels: sets of scenes, the first on top.
        paths: files to write; the ending says the format.
        legend: above the panels.
    """
    _save(lambda: chart_figure(panels, legend=legend), paths)


def plot_details(
    marks: Sequence[Mark],
    bands: Mapping[str, float],
    measures: Mapping[str, str],
    rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]],
    paths: Sequence[Path],
) -> None:
    """Draw all settings of one set of scenes: a panel for each measure, for throughput and for costs, if there are any.

    Args:
        marks: settings.
        bands: measure → relative uncertainty of the reference.
        measures: measure → in words; each is a panel, the first on top.
        rates: name → group, and batch and scenes per second of every size.
        paths: files to write.
    """
    _save(lambda: details_figure(marks, bands, measures, rates), paths)


def chart_figure(panels: Sequence[Panel], *, legend: bool = True) -> Any:
    """Return the headline as a figure of matplotlib; arguments as of `plot_chart`."""
    kept = [[mark for mark in panel.marks if mark.group not in (*ASIDE, "extrapolated")] for panel in panels]
    titles = [panel.title for panel in panels]
    figure, every = _stack(titles, [3.0] * len(panels), _legend(list(itertools.chain(*kept)), panels) if legend else [])
    for axes, panel, marks in zip(every, panels, kept, strict=True):
        _draw_errors(axes, marks, HEADLINE, panel.band, named=_needs_name, size=TEXT)
        axes.set_ylabel("worse of front and map")
    return figure


def details_figure(
    marks: Sequence[Mark],
    bands: Mapping[str, float],
    measures: Mapping[str, str],
    rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]],
) -> Any:
    """Return the details as a figure of matplotlib; arguments as of `plot_details`."""
    bought = [mark for mark in marks if mark.spent > 0 and math.isfinite(mark.errors[HEADLINE])]
    panels = [Panel("", marks, bands[measure]) for measure in measures]
    drawn = {f"Error of the {words}": 4.4 for words in measures.values()}
    drawn |= {"Throughput": 3.0} if rates else {}
    drawn |= {"Spent before, and the scenes after which it has paid": 2.4} if bought else {}
    figure, every = _stack(list(drawn), list(drawn.values()), _legend(marks, panels))
    for axes, measure in zip(every, measures, strict=False):
        _draw_errors(axes, marks, measure, bands[measure], named=lambda mark, measure: True, size=SMALL)
        axes.set_ylabel("error")
    rest = every[len(measures) :]
    if rates:
        _draw_rates(rest.pop(0), rates)
    if bought:
        _draw_costs(rest.pop(0), bought)
    return figure


def _needs_name(mark: Mark, measure: str) -> bool:
    return mark.group != "mpm" or measure in mark.on_fronts


def _save(make: Any, paths: Sequence[Path]) -> None:
    import matplotlib as mpl

    with mpl.rc_context(STYLE | {"font.size": TEXT, "axes.titlesize": TEXT, "axes.labelsize": TEXT}):
        figure = make()
        for path in paths:
            figure.savefig(path)


def _stack(titles: Sequence[str], heights: Sequence[float], handles: Sequence[Any]) -> tuple[Any, list[Any]]:
    """Return a figure with titled axes of these heights [inch], one under the other, and a legend above them."""
    from matplotlib.figure import Figure

    line, below, rows = 0.175, 0.52, math.ceil(len(handles) / 3)
    letters = [f"({letter}) " if len(titles) > 1 else "" for letter in "abcdefgh"]
    wrapped = [textwrap.wrap(letter + title, 72) for letter, title in zip(letters, titles, strict=False)]
    legend = 0.06 + (line + 0.005) * rows
    total = legend + sum(heights) + sum(0.14 + line * len(lines) + below for lines in wrapped)
    figure = Figure(figsize=(WIDTH, total))
    top, every = total - legend, []
    for height, lines in zip(heights, wrapped, strict=True):
        top -= 0.14 + line * len(lines) + height
        every.append(figure.add_axes((LEFT / WIDTH, top / total, (WIDTH - LEFT - RIGHT) / WIDTH, height / total)))
        every[-1].set_title("\n".join(lines), loc="left")
        top -= below
    if handles:
        figure.legend(
            handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1 - 0.03 / total), ncols=3, fontsize=TEXT,
            borderaxespad=0, borderpad=0, labelspacing=0.25, handletextpad=0.4, columnspacing=1.2, handlelength=1.6,
        )  # fmt: skip
    return figure, every


def _legend(marks: Sequence[Mark], panels: Sequence[Panel]) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    shown = {mark.drawn_as for mark in marks}
    handles: list[Any] = [
        Line2D([], [], label=words, **marker_style(group)) for group, (words, _, _) in GROUPS.items() if group in shown
    ]
    if any(mark.whole for mark in marks):
        handles.append(Line2D([], [], label="run in 3D", **marker_style("trivial", whole=True) | {"marker": "o"}))
    if any(mark.on_fronts for mark in marks):
        handles.append(Line2D([], [], color="black", linewidth=1.0, label="Pareto front"))
    if any(panel.band > 0 for panel in panels):
        handles.append(Patch(color="0.88", linewidth=0, label="reference uncertainty"))
    return handles


def _draw_errors(axes: Any, every: Sequence[Mark], measure: str, band: float, *, named: Any, size: float) -> None:
    marks = sorted((mark for mark in every if np.isfinite(mark.errors[measure])), key=lambda mark: mark.seconds)
    slow = [mark for mark in marks if mark.group not in ASIDE] or marks
    axes.set(xscale="log", yscale="log", xlabel="time of a scene [s]")
    if not marks:
        return
    left, right = min(mark.seconds for mark in slow) / 2, max(mark.seconds for mark in slow) * 2
    early = [mark for mark in marks if mark.seconds < left]
    edge = left / 1.6
    if early:
        left = edge / 1.6
    errors = [max(mark.errors[measure], LEAST) for mark in marks]
    bottom, top = 0.65 * min([*errors, *([max(band, LEAST)] if band > 0 else [])]), 1.6 * max(errors)
    axes.set(xlim=(left, right), ylim=(bottom, top))
    if band > 0:
        axes.axhspan(bottom, band, color="0.88", linewidth=0, zorder=-2)

    places = {mark.name: (edge if mark in early else mark.seconds, max(mark.errors[measure], LEAST)) for mark in marks}
    lines = []
    for mark in marks:
        x, y = places[mark.name]
        if mark in early:
            head = {"arrowstyle": "->", "color": GROUPS[mark.drawn_as][1], "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (left, y), xytext=(x, y), arrowprops=head, annotation_clip=False)
            lines.append([(left, y), (x, y)])
        else:
            low, high = max(left, min(mark.low, x)), min(right, max(mark.high, x))
            axes.plot([low, high], [y, y], color=GROUPS[mark.drawn_as][1], linewidth=0.9, zorder=1.9)
            lines.append([(low, y), (high, y)])
        axes.plot(x, y, **marker_style(mark.drawn_as, whole=mark.whole))
    front = [places[mark.name] for mark in marks if measure in mark.on_fronts]
    if front:
        corners = [(front[0][0], top), front[0]]
        for x, y in front[1:]:
            corners += [(x, corners[-1][1]), (x, y)]
        corners.append((right, front[-1][1]))
        axes.plot(*zip(*corners, strict=True), color="black", linewidth=1.0, zorder=1)
        lines += [list(pair) for pair in itertools.pairwise(corners)]
    number_axes(axes)
    labels = [(mark.label, places[mark.name], mark.drawn_as) for mark in marks if mark.label and named(mark, measure)]
    write_names(axes, labels, places.values(), lines, size)


def _draw_rates(axes: Any, rates: Mapping[str, tuple[str, Sequence[tuple[int, float]]]]) -> None:
    labels, places, lines = [], [], []
    for name, (group, points) in rates.items():
        known = group if group in GROUPS else "other"
        line = sorted(points)
        axes.plot(*zip(*line, strict=True), **marker_style(known) | {"linestyle": "-", "linewidth": 1.0})
        labels.append((shortened(name), line[-1], known))
        places += line
        lines += [list(pair) for pair in itertools.pairwise(line)]
    sizes = sorted({size for size, _ in places})
    axes.set(xscale="log", yscale="log", xlabel="scenes at once", ylabel="scenes per second")
    axes.set_xlim(sizes[0] / 1.15, sizes[-1] * max(2.0, (sizes[-1] / sizes[0]) ** 0.4))
    axes.set_ylim(0.6 * min(rate for _, rate in places), 1.6 * max(rate for _, rate in places))
    number_axes(axes, percent=False)
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.set_xticks([], minor=True)
    write_names(axes, labels, places, lines, SMALL)


def _draw_costs(axes: Any, marks: Sequence[Mark]) -> None:
    places = {mark.name: (mark.spent, max(mark.errors[HEADLINE], LEAST)) for mark in marks}
    for mark in marks:
        axes.plot(*places[mark.name], **marker_style(mark.drawn_as, whole=mark.whole))
    axes.set(xscale="log", yscale="log", xlabel="spent on data and training [s]", ylabel="worse of front and map")
    axes.set_xlim(min(mark.spent for mark in marks) / 4, 6 * max(mark.spent for mark in marks))
    axes.set_ylim(0.6 * min(y for _, y in places.values()), 1.6 * max(y for _, y in places.values()))
    number_axes(axes)
    labels = [(f"{shortened(mark.name)}: {mark.pays}", places[mark.name], mark.drawn_as) for mark in marks]
    write_names(axes, labels, places.values(), [], SMALL)
