"""From rows to points: every setting's time and errors over all scenes and placements, and what it compares with."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gns_pl.evaluation.chart.derived import extrapolated
from gns_pl.evaluation.chart.front import Setting, break_even, fastest_as_good, pareto_front, seconds_of_error
from gns_pl.evaluation.chart.plan import LEARNED, MEASURES, PLAIN, UNTRAINED, Plan, SceneFacts
from gns_pl.evaluation.chart.tables import Environment, RunRow, Table
from gns_pl.metrics.laws import LAWS
from gns_pl.solvers.trivial import FittedLaw


@dataclass(frozen=True)
class Point:
    """A setting on the chart.

    Attributes:
        name: of the setting.
        group: as of a run; besides "law" and "extrapolated", which give the runout alone.
        seconds: wall time of a scene [s]: median over the placements, mean over the scenes.
        seconds_low: the same of the fastest placement.
        seconds_high: of the slowest.
        cpu_seconds: processor time, likewise.
        scenes: number of those that it ran.
        front_error: root mean square of the final front's relative error over scenes and placements.
        map_error: the same of the share of the final volume in the wrong place; NaN of what gives no flow.
        largest_error: of the front's errors, signed.
        bias: mean of the front's errors.
        height_error: root mean square of the final mean height's.
        arrest_error: root mean square of that of the time after which the flow is over.
        profile_error: mean area between the final profiles over the deposit's.
        curve_error: mean over time, scenes and placements of the front's error, over the final one.
        runs: that went in.
        failed: how many of them did not reach the end.
        dim: of what was run; 0 where nothing was.
        particles: of the largest scene.
        dtype: of the arithmetic.
        device: "cpu" or "cuda".
        machine: on which it was measured.
        threads: that a run might use.
        versions: of packages.
        data_seconds: spent before on data [s]; NaN where nobody knows, 0 where nothing was.
        train_seconds: on training, likewise.
        equal_seconds: what the cheapest solver without a network takes on the same scenes for the same error, by the
            worse of front and map, or of what gives no flow by the front [s].
        break_even: scenes after which it paid; infinite: never.
        first_seconds: median of the first, untimed runs, what was compiled in them included.
        file_seconds: median time to write the frames to a file.
        on_fronts: the keys of `plan.MEASURES` by which no setting that gives a flow and runs all scenes beats it.
    """

    name: str
    group: str
    seconds: float
    seconds_low: float
    seconds_high: float
    cpu_seconds: float
    scenes: int
    front_error: float
    map_error: float
    largest_error: float
    bias: float
    height_error: float
    arrest_error: float
    profile_error: float
    curve_error: float
    runs: int
    failed: int
    dim: int
    particles: int
    dtype: str
    device: str
    machine: str
    threads: int
    versions: str
    data_seconds: float = 0.0
    train_seconds: float = 0.0
    equal_seconds: float = math.nan
    break_even: float = math.nan
    first_seconds: float = math.nan
    file_seconds: float = math.nan
    on_fronts: str = ""

    def error(self, measure: str) -> float:
        """Return its error by a key of `plan.MEASURES`; infinite where it failed or gives none."""
        errors = {"front": self.front_error, "map": self.map_error}
        errors = {name: math.inf if math.isnan(value) else value for name, value in errors.items()}
        return max(errors.values()) if measure == "worse" else errors[measure]

    def setting(self, measure: str) -> Setting:
        """Return where it lies by a key of `plan.MEASURES`."""
        return Setting(self.name, self.seconds, self.error(measure))

    @property
    def gives_flow(self) -> bool:
        """Whether it gives more than a runout."""
        return self.group not in ("law", "extrapolated")


def points_of(plan: Plan, table: Table[RunRow]) -> list[Point]:
    """Return all points of a chart, compared, the fastest first; settings that were not run yet are not among them.

    Args:
        plan: of the chart.
        table: of runs.
    """
    rows = rows_by_name(plan, table)
    points = [point_of(of_name) for of_name in rows.values()]
    if plan.law:
        published, fitted = LAWS[0], FittedLaw(plan.law)
        for name, law, spent in (("law_lube", published, 0.0), ("law_fitted", fitted, plan.law_seconds)):
            began = time.perf_counter()
            for _ in range(100):
                law(1.0)
            seconds = (time.perf_counter() - began) / 100
            points.append(law_point(name, law, plan.scenes, seconds, spent, next(iter(plan.places.values()))))
    return compared(points, rows, plan)


def seconds_elsewhere(plan: Plan, table: Table[RunRow]) -> dict[int, dict[str, float]]:
    """Return the times on other numbers of threads: number → name of a setting → seconds, as `Point.seconds`.

    Args:
        plan: of the chart.
        table: of runs.
    """
    found: dict[int, dict[str, float]] = {}
    for number in plan.more_threads:
        rows: dict[str, list[RunRow]] = {}
        for row in plan.runs(table, number):
            rows.setdefault(row.name, []).append(row)
        found[number] = {name: point_of(of_name).seconds for name, of_name in rows.items()}
    return found


def rivals(
    rows: Mapping[str, Sequence[RunRow]], name: str, groups: Sequence[str] = UNTRAINED
) -> dict[str, list[RunRow]]:
    """Return the runs of other settings on the scenes that a setting ran, so that both are judged by the same.

    Args:
        rows: name of every setting → its runs.
        name: of the setting; one without runs is compared on all scenes.
        groups: of the others.

    Returns:
        Name → runs, of those that ran all these scenes.
    """
    ran = {row.scene for row in rows.get(name, ())}
    found = {}
    for other, of_name in rows.items():
        same = [row for row in of_name if not ran or row.scene in ran]
        if other != name and of_name[0].group in groups and {row.scene for row in same} >= ran:
            found[other] = same
    return found


def line_of(rows: Mapping[str, Sequence[RunRow]], measure: str) -> list[Setting]:
    """Return where settings lie by a key of `plan.MEASURES`.

    Args:
        rows: name of every setting → its runs.
        measure: the key.
    """
    return [point_of(of_name).setting(measure) for of_name in rows.values()]


def rows_by_name(plan: Plan, table: Table[RunRow]) -> dict[str, list[RunRow]]:
    """Return every setting's runs, those that are extrapolated from two others among them.

    Args:
        plan: of the chart.
        table: of runs.
    """
    found: dict[str, list[RunRow]] = {}
    for row in plan.runs(table):
        found.setdefault(row.name, []).append(row)
    for coarse, fine in plan.pairs:
        first, second = (found.get(f"mpm_{cells:g}", []) for cells in (coarse, fine))
        for row in extrapolated(first, second, ratio=fine / coarse, order=plan.order):
            found.setdefault(row.name, []).append(row)
    return found


def point_of(rows: Sequence[RunRow]) -> Point:
    """Return the point of a setting.

    Args:
        rows: its runs, of all scenes.
    """
    of_scene: dict[str, list[float]] = {}
    busy: dict[str, list[float]] = {}
    for row in rows:
        of_scene.setdefault(row.scene, []).append(row.seconds)
        busy.setdefault(row.scene, []).append(row.cpu_seconds)
    errors = [row.front_error for row in rows]
    first = rows[0]
    return Point(
        name=first.name,
        group=first.group,
        seconds=statistics.mean(statistics.median(each) for each in of_scene.values()),
        seconds_low=statistics.mean(min(each) for each in of_scene.values()),
        seconds_high=statistics.mean(max(each) for each in of_scene.values()),
        cpu_seconds=statistics.mean(statistics.median(each) for each in busy.values()),
        scenes=len(of_scene),
        front_error=_root_mean_square(errors),
        map_error=_root_mean_square([row.map_error for row in rows]),
        largest_error=max(errors, key=abs),
        bias=statistics.mean(errors),
        height_error=_root_mean_square([row.height_error for row in rows]),
        arrest_error=_root_mean_square([row.arrest_error for row in rows]),
        profile_error=statistics.mean(row.profile_error for row in rows),
        curve_error=statistics.mean(row.curve_error for row in rows),
        runs=len(rows),
        failed=sum(math.isinf(each) for each in errors),
        dim=first.dim,
        particles=max(row.particles for row in rows),
        dtype=first.dtype,
        device=first.device,
        machine=first.machine,
        threads=first.threads,
        versions=first.versions,
        first_seconds=statistics.median(row.first_seconds for row in rows),
        file_seconds=statistics.median(row.file_seconds for row in rows),
    )


def law_point(
    name: str,
    law: Callable[[float], float],
    scenes: Sequence[SceneFacts],
    seconds: float,
    data_seconds: float,
    place: Environment,
) -> Point:
    """Return the point of a law of the aspect ratio, which gives the runout and nothing else.

    Args:
        name: of the law.
        law: aspect ratio → runout [L0].
        scenes: columns, with their true fronts.
        seconds: that one evaluation takes [s].
        data_seconds: of the runs it was fitted to [s]; 0 for a published one.
        place: of the other settings.
    """
    errors = [law(each.aspect_ratio) * each.length / each.front - 1 for each in scenes]
    return Point(
        name=name, group="law", seconds=seconds, seconds_low=seconds, seconds_high=seconds, cpu_seconds=seconds,
        scenes=len(scenes), front_error=_root_mean_square(errors), map_error=math.nan,
        largest_error=max(errors, key=abs), bias=statistics.mean(errors), height_error=math.nan, arrest_error=math.nan,
        profile_error=math.nan, curve_error=math.nan, runs=len(errors), failed=0, dim=0, particles=0, dtype="float64",
        device="cpu", machine=place.machine, threads=place.threads, versions=place.versions, data_seconds=data_seconds,
    )  # fmt: skip


def compared(points: Sequence[Point], rows: Mapping[str, Sequence[RunRow]], plan: Plan) -> list[Point]:
    """Return the points with what was spent on them, break-even numbers and the Pareto fronts, the fastest first.

    Args:
        points: of all settings.
        rows: name of every setting → its runs.
        plan: of the chart.
    """
    whole = [each for each in points if each.gives_flow and each.scenes == len(plan.scenes)]
    fronts = {
        measure: {spot.name for spot in pareto_front([p.setting(measure) for p in whole])} for measure in MEASURES
    }
    found = []
    for each in points:
        if each.group in LEARNED and each.name in plan.costs:
            cost = plan.costs[each.name]
            each = replace(each, data_seconds=cost.data_seconds, train_seconds=cost.train_seconds)
        measure = "worse" if each.gives_flow else "front"
        if each.group in (*LEARNED, "law") and math.isfinite(each.error(measure)):
            error = each.error(measure)
            best = fastest_as_good(line_of(rivals(rows, each.name), measure), error)
            along = seconds_of_error(line_of(rivals(rows, each.name, PLAIN), measure), error)
            equal = along if best is None else min(along, best.seconds)
            spent = each.data_seconds + each.train_seconds
            each = replace(each, equal_seconds=equal, break_even=break_even(spent, equal, each.seconds))
        on_fronts = " ".join(measure for measure, names in fronts.items() if each.name in names)
        found.append(replace(each, on_fronts=on_fronts))
    return sorted(found, key=lambda each: (each.seconds, each.name))


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
