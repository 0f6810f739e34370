"""One page and one figure of several charts, each of its own set of scenes: who wins where."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gns_pl.evaluation.chart.draw import FIGURES, panel_of
from gns_pl.evaluation.chart.front import fastest_as_good
from gns_pl.evaluation.chart.markdown import LEGEND, headline, markdown_table, threads_of
from gns_pl.evaluation.chart.plan import MEASURES, PAGE, Plan
from gns_pl.evaluation.chart.points import Point, points_of, rows_by_name
from gns_pl.evaluation.chart.tables import RunRow, Tables
from gns_pl.evaluation.chart.verdicts import percent
from gns_pl.evaluation.report import run
from gns_pl.io.atomic import write_atomically
from gns_pl.text import seconds
from gns_pl.viz import plot_chart

LEVELS = (0.2, 0.1, 0.07, 0.05, 0.04, 0.03)
"""Errors for which the cheapest solver is named."""


@dataclass(frozen=True)
class Chart:
    """A chart that was measured.

    Attributes:
        folder: of its plan and tables.
        plan: what it is about.
        points: its settings.
        rows: name of every setting → its runs.
    """

    folder: Path
    plan: Plan
    points: Sequence[Point]
    rows: Mapping[str, Sequence[RunRow]]

    @classmethod
    def of(cls, folder: Path, plan: Plan, tables: Tables) -> Chart:
        """Return the chart of a folder's plan and tables."""
        return cls(folder, plan, points_of(plan, tables.runs), rows_by_name(plan, tables.runs))

    def cheapest(self, measure: str, error: float) -> str:
        """Return which solver that gives a flow of all scenes has an error for the least time, as a cell of a table.

        Args:
            measure: key of `MEASURES`.
            error: relative.
        """
        group = {point.name: point.group for point in self.points}
        spots = [
            each.setting(measure) for each in self.points if each.gives_flow and each.scenes == len(self.plan.scenes)
        ]
        best = fastest_as_good(spots, error)
        if best is None:
            return "none here"
        other = fastest_as_good([spot for spot in spots if group[spot.name] != group[best.name]], error)
        behind = "" if other is None else f"; `{other.name}` × {other.seconds / best.seconds:.2g}"
        return f"**`{best.name}`** {seconds(best.seconds)}{behind}"


def draw_all(charts: Sequence[Chart], out: Path) -> list[Path]:
    """Write the page and the figure of several charts.

    Args:
        charts: in their order.
        out: folder.

    Returns:
        The files made.
    """
    out.mkdir(parents=True, exist_ok=True)
    figures = [out / name for name in FIGURES]
    write_atomically(out / PAGE, overview(charts, f"python {run()['command']}", out).encode())
    plot_chart([panel_of(chart.plan, chart.points) for chart in charts], figures)
    return [out / PAGE, *figures]


def overview(charts: Sequence[Chart], command: str, out: Path) -> str:
    """Return the page.

    Args:
        charts: in their order.
        command: by which it is made.
        out: folder in which the page will lie.
    """
    titles = [chart.plan.title for chart in charts]
    places = dict.fromkeys(
        f"{place.machine}, {place.device}, {threads_of(place)} a run"
        for chart in charts
        for place in chart.plan.places.values()
    )
    lines = [
        "# Speed against accuracy",
        "",
        f"Made by `{command}` from tables that `benchmark.py` measured on {'; '.join(places)}; every number and "
        "sentence below is the script's.",
        "",
        "![error over time: a panel for every set of scenes](chart.png)",
        "",
        LEGEND,
        "",
        "## Who wins where",
        "",
        "The cheapest solver that gives a flow of all scenes with at most such an error, and behind it the cheapest of "
        "another kind, with its time over that of the first. The error is a root mean square over scenes and "
        "placements against a fine reference.",
    ]
    for measure in reversed(MEASURES):
        cells = [(percent(level), *(chart.cheapest(measure, level) for chart in charts)) for level in LEVELS]
        lines += ["", f"### By {MEASURES[measure]}", "", *markdown_table(("error at most", *titles), cells)]
    for chart in charts:
        link = Path(os.path.relpath(chart.folder / PAGE, out)).as_posix()
        bands = [f"{name} {percent(chart.plan.band(name))}" for name in ("front", "map")]
        lines += [
            "",
            f"## {chart.plan.title[0].upper()}{chart.plan.title[1:]}",
            "",
            *headline(chart.plan, chart.points, chart.rows),
            "",
            f"The references are uncertain by {', '.join(bands)}. All settings, scene by scene, what was left out, and "
            f"how it was measured: [{link}]({link}).",
        ]
    return "\n".join([*lines, ""])
