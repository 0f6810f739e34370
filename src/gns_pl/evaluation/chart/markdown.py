"""The chart in words: chart.md, and what stands under the figure. Every number comes from the rows."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence

from gns_pl.evaluation.chart.plan import COMPARED, LEARNED, MEASURES, Plan, SceneFacts
from gns_pl.evaluation.chart.points import Point
from gns_pl.evaluation.chart.tables import BatchRow, Environment, RunRow
from gns_pl.evaluation.chart.uncertain import INSIDE, equal_error
from gns_pl.evaluation.chart.verdicts import Verdict, pace_of, percent
from gns_pl.metrics.maps import MAP_CELL, TERRAIN_NODES
from gns_pl.metrics.measures import ARREST_SHARE
from gns_pl.text import seconds

HEAD = (
    *("setting", "scenes", "particles", "seconds", "processor s", "front", "map", "front: largest", "mean", "height"),
    *("arrest", "front over time", "first run", "file"),
)


LEGEND = (
    "*1/N is plain MPM on cells of √(L0 H0)/N, (4/6) behind a name that it ran four of six scenes. Plain MPM off the "
    "Pareto front has no name; laws, extrapolations and what moves nothing are not drawn. Grey: the reference's own "
    "uncertainty.*"
)
"""What stands under a figure of the worse of front and map."""


def caption(found: Sequence[Verdict], points: Sequence[Point], band: float, measure: str) -> str:
    """Return who wins by one measure, and what the laws do, in words.

    Args:
        found: verdict on every trained solver.
        points: of the chart.
        band: uncertainty of the reference, relative.
        measure: key of `MEASURES` by which all these are.
    """
    won = [each for each in found if each.solver_wins]
    level = [each.own.name for each in found if each.level and not each.own.failed]
    lost = [each for each in found if not each.solver_wins and not each.level and not each.own.failed]
    parts = []
    if won:
        names = ", ".join(f"{each.own.name} ({pace_of(each.good_ratio or 1.0)})" for each in won)
        parts.append(
            f"A solver without a network wins, as accurate in less time, against {len(won)} of {len(found)} trained "
            f"ones: {names}."
        )
    elif found:
        parts.append(f"No solver without a network wins against one of {len(found)} trained ones.")
    if level:
        parts.append(f"Level with the fastest as accurate without one: {', '.join(level)}.")
    for each in lost:
        other = "nothing without a network is as accurate"
        if each.as_good is not None:
            other = f"{each.as_good.name}, as accurate, {pace_of(each.good_ratio or 1)}"
        parts.append(f"{each.own.name} is ahead: {other}.")
    failed = [each.own.name for each in found if each.own.failed]
    if failed:
        parts.append(f"Failed: {', '.join(failed)}.")
    front = [each.name for each in points if measure in each.on_fronts.split()]
    parts.append(f"On the Pareto front: {', '.join(front)}.")
    good = sorted(
        (each for each in points if not each.gives_flow and each.front_error < 0.1), key=lambda each: each.front_error
    )
    if good and measure == "front":
        laws = ", ".join(f"{each.name} {percent(each.front_error)}" for each in good[:3])
        parts.append(f"The runout alone is also had from {laws}.")
    parts.append(f"Differences below {percent(band)}, the reference's own uncertainty, mean nothing.")
    return " ".join(parts)


def page(
    plan: Plan,
    points: Sequence[Point],
    found: Mapping[str, Sequence[Verdict]],
    rows: Mapping[str, Sequence[RunRow]],
    batches: Sequence[BatchRow],
    said: Mapping[str, str],
    elsewhere: Mapping[int, Mapping[str, float]],
) -> str:
    """Return chart.md.

    Args:
        plan: of the chart.
        points: of the chart, compared.
        found: key of `MEASURES` → verdict on every trained solver.
        rows: name of every setting → its runs.
        batches: throughput.
        said: key of `MEASURES` → the `caption` by it; the last one is that of the figure.
        elsewhere: other number of threads → name → seconds.
    """
    scenes = plan.scenes
    where = "; ".join(
        f"{place.machine}, {place.device}, {threads_of(place)} a run ({place.versions})"
        for place in plan.places.values()
    )
    number = min((each.runs for each in points if each.group == "mpm"), default=0) // max(1, len(scenes))
    few = " **Fewer than five: a quick look, not a measurement.**" if number < 5 else ""
    mixed = len({row.session for runs in rows.values() for row in runs}) > 1
    sittings = " (in several sittings here; ratios of trained solvers and MPM are from one)" if mixed else ""
    lines = [
        f"# Speed against accuracy: {plan.title}",
        "",
        f"Made by `{plan.command}`; every number and sentence below is the script's. Measured on {where}.",
        "",
        "![wall time and error, the worse of front and map](chart.png)",
        "",
        LEGEND,
        "",
        f"By {MEASURES['worse']}: {said['worse']}",
        "",
        "![by front, by map; throughput, cost](details.png)",
        "",
        "## What is measured",
        "",
        *(_scene_line(each) for each in scenes),
        "",
        "Three errors, relative to the reference, as root mean square over scenes and placements "
        f"({number} each). **Front**: of its final advance, 99 % of the mass, along x for a column, else in whatever "
        "direction from where the bodies were released. **Map**: the share of the final volume in the wrong place, on "
        f"a horizontal grid of {_map_cell(plan.kind)} (in plane strain along x). **The worse of the two**: a solver is "
        "as accurate as that. Height: of the final mean height; arrest: of the time after which the kinetic energy "
        f"stays below {100 * ARREST_SHARE:g} % of its peak. Times are medians over as many warm runs, in turns with "
        f"all others in one process{sittings}, and means over the scenes.{few} In them are: placing the particles, "
        "neighbour search, network or grid, integration, copies of every frame to the host. Not in them: compilation, "
        "reading checkpoints, writing files; the table has the first run, with what was compiled in it, and the "
        f"writing of a file apart. All give frames {scenes[0].interval:g} s apart. Slices are measured as slices.",
        "",
        "## Against plain MPM of equal error",
        "",
        *headline(plan, points, rows),
        "",
        "## Who wins",
        "",
        "A trained solver that cannot run all scenes is compared with others on those which it ran.",
        *_verdict_lines(found, said),
        "",
        "## All settings",
        "",
        *markdown_table(
            (*HEAD, *(f"seconds, {number} thread{'s' * (number > 1)}" for number in elsewhere)),
            [
                (*_point_cells(each), *(_plain(times.get(each.name, math.nan)) for times in elsewhere.values()))
                for each in points
            ],
        ),
        "",
        "Bold: on a Pareto front, by front, map or the worse, of what gives a flow and runs all scenes. `mpm_N`: cells "
        "of √(L0 H0)/N, two points per direction unless "
        "`_pN`; `_cX`: Courant number X; `_whole`: in three dimensions. `extrapolated_A_B`: the runout of `mpm_A` and "
        "`mpm_B`, extrapolated to a cell of no size.",
        "",
        "## By scene",
        "",
        "Mean ± standard deviation of the front's error over the placements, in brackets the largest of them; then the "
        "mean map error.",
        "",
        *markdown_table(("setting", *(each.name for each in scenes)), _scene_cells(rows, points, scenes)),
    ]
    if batches:
        lines += ["", "## Many scenes at once", "", "Scenes a second, all frames in memory.", ""]
        lines += _batch_table(batches)
    spent = [each for each in points if each.group in LEARNED or (each.group == "law" and each.data_seconds)]
    known = {name: cost.source for name, cost in plan.costs.items()}
    lines += [
        "",
        "## What it cost before",
        "",
        "N* = (data + training) / (time of the cheapest of equal error without a network, plain MPM's along its line, "
        "− own time): scenes until it has paid. The error is the worse of front and map, of laws that of the front.",
        "",
        *markdown_table(
            ("solver", "data", "training", "own time", "cheapest of equal error", "N*", "known from"),
            [(*_cost_cells(each), known.get(each.name, "")) for each in spent],
        ),
    ]
    if plan.told():
        lines += ["", "## What is not run, or outside of its range", "", *(f"- {line}." for line in plan.told())]
    return "\n".join([*lines, ""])


def headline(plan: Plan, points: Sequence[Point], rows: Mapping[str, Sequence[RunRow]]) -> list[str]:
    """Return the table of all solvers but plain MPM that give a flow, and what it says.

    Args:
        plan: of the chart.
        points: of the chart, the fastest first.
        rows: name of every setting → its runs.
    """
    table = []
    for each in points:
        if each.group in COMPARED:
            ratios = [equal_error(plan, rows, each.name, measure) for measure in MEASURES]
            words = ["–" if ratio is None else ratio.words() for ratio in ratios]
            errors = (percent(each.front_error), percent(each.map_error), percent(each.height_error))
            scenes = f"{each.scenes} of {len(plan.scenes)}"
            table.append((f"`{each.name}`", scenes, *errors, seconds(each.seconds), seconds(each.cpu_seconds), *words))
    head = ("solver", "scenes", "front", "map", "height", "wall", "processor", "by front", "by map", "by the worse")
    return [
        "How many times as long plain MPM takes for the error that a solver has, along its line of settings; in "
        f"brackets the middle {INSIDE[1] - INSIDE[0]:g} % of what placements and the reference's own uncertainty leave "
        "open. Below 1 MPM is faster. `> N`: no MPM of the chart is as accurate; the most accurate "
        "takes N times as long.",
        "",
        *markdown_table(head, table),
    ]


def _verdict_lines(found: Mapping[str, Sequence[Verdict]], said: Mapping[str, str]) -> list[str]:
    lines = []
    for measure, of_measure in found.items():
        sentences = [f"- {each.sentence()}{'' if each.in_turns else ' (not timed in turns)'}." for each in of_measure]
        lines += ["", f"### By {MEASURES[measure]}", "", said[measure], "", *sentences]
    return lines


def _cost_cells(each: Point) -> tuple[str, ...]:
    equal = "none as accurate" if math.isinf(each.equal_seconds) else seconds(each.equal_seconds)
    times = (seconds(each.data_seconds), seconds(each.train_seconds), seconds(each.seconds))
    return (f"`{each.name}`", *times, equal, scenes_of(each))


def threads_of(place: Environment) -> str:
    """Return how many threads a run had, in words."""
    return f"{place.threads} thread{'s' if place.threads > 1 else ''}"


def scenes_of(point: Point) -> str:
    """Return a break-even number in words."""
    if math.isnan(point.break_even):
        return "unknown"
    if math.isinf(point.break_even):
        return "never"
    return "at once" if math.isinf(point.equal_seconds) else f"{math.ceil(point.break_even):,}"


def _map_cell(kind: str) -> str:
    """Return the size of a map's cells on scenes of a kind (`metrics.maps.map_cell`)."""
    return f"√(L0 H0)/{TERRAIN_NODES:g}" if kind == "terrain" else f"{MAP_CELL:.3g} m"


def _scene_line(each: SceneFacts) -> str:
    front = f"{each.front:.4g} m" + (f" ({each.front / each.length:.4g} L0)" if each.column else "")
    within = ", ".join(f"{name} {percent(value)}" for name, value in each.uncertainty.items())
    return (
        f"- `{each.name}`, {each.duration:.3g} s: front {front} by {each.words}; uncertain by {within}; "
        f"{seconds(each.seconds)} of processor time a run."
    )


def _point_cells(each: Point) -> tuple[str, ...]:
    name = f"**`{each.name}`**" if each.on_fronts else f"`{each.name}`"
    failed = f", {each.failed} of {each.runs} failed" if each.failed else ""
    apart = (_plain(each.first_seconds), _plain(each.file_seconds)) if each.gives_flow else ("–", "–")
    return (
        name, str(each.scenes), f"{each.particles:,}" if each.particles else "–", f"{each.seconds:.3g}",
        f"{each.cpu_seconds:.3g}", percent(each.front_error) + failed, percent(each.map_error),
        _signed(each.largest_error), _signed(each.bias), percent(each.height_error), percent(each.arrest_error),
        percent(each.curve_error), *apart,
    )  # fmt: skip


def _scene_cells(
    rows: Mapping[str, Sequence[RunRow]], points: Sequence[Point], scenes: Sequence[SceneFacts]
) -> list[tuple[str, ...]]:
    table = []
    for each in points:
        if each.name in rows:
            by_scene = [[row for row in rows[each.name] if row.scene == scene.name] for scene in scenes]
            table.append((f"`{each.name}`", *map(_spread, by_scene)))
    return table


def _spread(rows: Sequence[RunRow]) -> str:
    errors = [row.front_error for row in rows]
    if not errors or not all(map(math.isfinite, errors)):
        return "failed" if errors else "–"
    mean, scatter, largest = statistics.mean(errors), statistics.pstdev(errors), max(errors, key=abs)
    front = f"{100 * mean:+.1f} ± {100 * scatter:.1f} ({100 * largest:+.1f})"
    return f"{front}; {percent(statistics.mean(row.map_error for row in rows))}"


def _batch_table(batches: Sequence[BatchRow]) -> list[str]:
    sizes = sorted({row.batch for row in batches})
    names = list(dict.fromkeys(row.name for row in batches))
    found = {(row.name, row.batch): f"{row.scenes_per_second:.3g}" for row in batches}
    how = {row.name: row.how for row in batches}
    cells = [(f"`{name}`", how[name], *(found.get((name, size), "–") for size in sizes)) for name in names]
    return markdown_table(("setting", "at once as", *map(str, sizes)), cells)


def markdown_table(head: Sequence[str], cells: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *cells)]


def _signed(value: float) -> str:
    return percent(value) if not math.isfinite(value) else f"{100 * value:+.1f} %"


def _plain(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "–"
