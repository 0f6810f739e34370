"""From the tables and the plan of a folder to figure, page and table of points. Nothing is measured here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation import tracking
from gns_pl.evaluation.chart.markdown import caption, page, scenes_of
from gns_pl.evaluation.chart.plan import MEASURES, Plan
from gns_pl.evaluation.chart.points import Point, points_of, rows_by_name
from gns_pl.evaluation.chart.tables import Tables
from gns_pl.evaluation.chart.verdicts import verdicts
from gns_pl.io.atomic import write_atomically
from gns_pl.io.tables import write_table
from gns_pl.viz import Mark, Panel, plot_chart, plot_details

PAGE, POINTS, FIGURES, DETAILS = "chart.md", "chart.csv", ("chart.png", "chart.svg"), ("chart_details.png",)


def draw(plan: Plan, tables: Tables, out: Path, *, logger: Mapping[str, Any] | None) -> list[Path]:
    """Write figure, page and table of points, print the caption, and log all to W&B if asked.

    Args:
        plan: of the chart.
        tables: that hold its rows.
        out: folder.
        logger: {offline, project} of W&B; None logs nothing.

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
    marks = [
        Mark(
            name=each.name, group=each.group, seconds=each.seconds, low=each.seconds_low,
            high=each.seconds_high, errors={measure: each.error(measure) for measure in MEASURES},
            label=label(each, len(plan.scenes)), whole=each.name.endswith("_whole"), on_fronts=each.on_fronts.split(),
            spent=each.data_seconds + each.train_seconds, pays=scenes_of(each),
        )
        for each in points
    ]  # fmt: skip
    rates: dict[str, tuple[str, list[tuple[int, float]]]] = {}
    for row in batches:
        rates.setdefault(row.name, (row.group, []))[1].append((row.batch, row.scenes_per_second))
    figures, details = [out / name for name in FIGURES], [out / name for name in DETAILS]
    write_atomically(out / PAGE, page(plan, points, found, rows, batches, said).encode())
    write_table(out / POINTS, Point, points)
    title = ", ".join(each.name for each in plan.scenes)
    plot_chart([Panel(title, marks, plan.band("worse"))], figures)
    measures = {measure: words for measure, words in MEASURES.items() if measure != "worse"}
    plot_details(marks, {measure: plan.band(measure) for measure in measures}, measures, rates, details)
    print(f"\n{under}\n")
    made = [out / PAGE, out / POINTS, *figures, *details]
    if logger is not None:
        made += tracking.log_chart(points, figures[0], under, command=plan.command, out=out, **logger)
    return made


def label(point: Point, scenes: int) -> str:
    """Return what is written beside a point: its name, and how many scenes it ran where these are not all."""
    return point.name if point.scenes == scenes else f"{point.name} ({point.scenes}/{scenes})"
