"""From the tables and the plan of a folder to figures, page and table of points. Nothing is measured here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation import tracking
from gns_pl.evaluation.chart.markdown import caption, page, scenes_of, threads_of
from gns_pl.evaluation.chart.plan import MEASURES, PAGE, Plan
from gns_pl.evaluation.chart.points import Point, points_of, rows_by_name, seconds_elsewhere
from gns_pl.evaluation.chart.tables import Tables
from gns_pl.evaluation.chart.verdicts import verdicts
from gns_pl.io.atomic import write_atomically
from gns_pl.io.tables import write_table
from gns_pl.viz import Mark, Panel, plot_chart, plot_details

POINTS, FIGURES, DETAILS = "chart.csv", ("chart.png", "chart.svg"), ("details.png", "details.svg")


def draw(plan: Plan, tables: Tables, out: Path, *, logger: Mapping[str, Any] | None, tell: bool = True) -> list[Path]:
    """Write figures, page and table of points, print the caption, and log all to W&B if asked.

    Args:
        plan: of the chart.
        tables: that hold its rows.
        out: folder.
        logger: {offline, project} of W&B; None logs nothing.
        tell: print the caption.

    Returns:
        The files made.

    Raises:
        InputError: the tables hold no run of the chart.
    """
    rows, batches = rows_by_name(plan, tables.runs), plan.batches(tables.batches)
    if not rows:
        raise InputError(f"{tables.runs.path}: holds no run of the chart; leave out from_table=true.")
    points = points_of(plan, tables.runs)
    ratios = plan.ratios(tables.ratios)
    found = {measure: verdicts(points, rows, ratios, measure) for measure in MEASURES}
    said = {measure: caption(of, points, plan.band(measure), measure) for measure, of in found.items()}
    under = f"By {MEASURES['worse']}: {said['worse']}"
    rates: dict[str, tuple[str, list[tuple[int, float]]]] = {}
    for row in batches:
        rates.setdefault(row.name, (row.group, []))[1].append((row.batch, row.scenes_per_second))
    figures, details = ([out / name for name in names] for names in (FIGURES, DETAILS))
    elsewhere = seconds_elsewhere(plan, tables.runs)
    write_atomically(out / PAGE, page(plan, points, found, rows, batches, said, elsewhere).encode())
    write_table(out / POINTS, Point, points, digits=6)
    plot_chart([panel_of(plan, points)], figures)
    parts = {measure: words for measure, words in MEASURES.items() if measure != "worse"}
    bands = {measure: plan.band(measure) for measure in parts}
    plot_details(marks_of(plan, points), bands, parts, rates, details)
    if tell:
        print(f"\n{under}\n")
    made = [out / PAGE, out / POINTS, *figures, *details]
    if logger is not None:
        made += tracking.log_chart(points, figures[0], under, command=plan.command, out=out, **logger)
    return made


def panel_of(plan: Plan, points: Sequence[Point]) -> Panel:
    """Return what of a chart stands in the figure of one or several."""
    threads = dict.fromkeys(threads_of(place) for place in plan.places.values())
    title = f"{plan.title[0].upper()}{plan.title[1:]}, {' and '.join(threads)}"
    return Panel(title, marks_of(plan, points), plan.band("worse"))


def marks_of(plan: Plan, points: Sequence[Point]) -> list[Mark]:
    """Return the settings of a chart as they are drawn."""
    return [
        Mark(
            name=each.name, group=each.group, seconds=each.seconds, low=each.seconds_low,
            high=each.seconds_high, errors={measure: each.error(measure) for measure in MEASURES},
            label=label(each, len(plan.scenes)), whole=each.name.endswith("_whole"), on_fronts=each.on_fronts.split(),
            spent=each.data_seconds + each.train_seconds, pays=scenes_of(each),
        )
        for each in points
    ]  # fmt: skip


def label(point: Point, scenes: int) -> str:
    """Return what is written beside a point: its name, and how many scenes it ran where these are not all."""
    return point.name if point.scenes == scenes else f"{point.name} ({point.scenes}/{scenes})"
