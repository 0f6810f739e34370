"""How often `simulate.py tolerance=…` keeps its promise: every choice is run from placements that no table has seen.

    python benchmarks/promise.py                 # measure what docs/promise.csv lacks, or what the records choose
                                                 # otherwise by now; write into docs/simulate.md
    python benchmarks/promise.py --of front map  # of other quantities than the worse of front and map
    python benchmarks/promise.py --from-table    # write the table again

Scenes are those of the chart (conf/evaluation), and columns between its two, of which no solver was measured. The
solver is chosen as `simulate.py` chooses it, by the package's records; its run is judged as the chart judges, by the
quantity of the tolerance, against the same references. A promise holds if the largest error of three placements is
within the tolerance. Where no error is promised (the scene is like none that was measured), what was chosen is judged
too.
"""

from __future__ import annotations

import argparse
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.converged import Converged, converged
from gns_pl.evaluation.chart.entries import scene_of
from gns_pl.evaluation.chart.speed import timed_run
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.io.tables import read_table, write_table
from gns_pl.scene import Scene
from gns_pl.solvers.catalogue import make_solvers
from gns_pl.solvers.selection import (
    QUANTITIES,
    RECORDS,
    WORSE,
    Option,
    choose,
    estimate,
    kind_of,
    read_records,
    with_worse,
)

ROOT = Path(__file__).parents[1]
TABLE, PAGE = ROOT / "docs" / "promise.csv", ROOT / "docs" / "simulate.md"
TOLERANCES = (0.2, 0.1, 0.07, 0.05, 0.03)
SEEDS = (100, 101, 102)  # the chart's placements begin at 0
BETWEEN = {"column_1.2": (0.383, 0.46), "column_1.6": (0.33, 0.528)}  # length and height [m]


@dataclass(frozen=True)
class Row:
    """A choice and what became of it.

    Attributes:
        scene: its name.
        kind: "plane" or "space".
        tolerance: that was asked for.
        solver: chosen; "" where none meets the tolerance.
        expected: error; NaN where none is promised.
        front_error: the largest of the placements, relative, signed.
        map_error: the largest.
        expected_seconds: of a run.
        seconds: the mean.
        of: the quantity of the tolerance (`selection.QUANTITIES`).
        height_error: the largest of the final mean height, signed; NaN in tables from before it was measured.
    """

    scene: str
    kind: str
    tolerance: float
    solver: str
    expected: float
    front_error: float
    map_error: float
    expected_seconds: float
    seconds: float
    of: str = WORSE
    height_error: float = math.nan

    @property
    def error(self) -> float:
        """That in the quantity of the tolerance."""
        errors = {"front": abs(self.front_error), "map": self.map_error, "height": abs(self.height_error)}
        return with_worse(errors)[self.of]

    @property
    def outcome(self) -> str:
        """What became of it, in a word."""
        if not self.solver:
            return "refused"
        within = self.error <= self.tolerance
        if self.expected != self.expected:
            return "unpromised, within" if within else "unpromised, beyond"
        return "held" if within else "broken"


def settings(*overrides: str) -> dict[str, Any]:
    """Return the settings of benchmark.py."""
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        return OmegaConf.to_container(compose("benchmark", overrides=list(overrides)), resolve=True)  # type: ignore[return-value]


def scenes_of(config: Mapping[str, Any], *, between: bool) -> list[Scene]:
    """Return the scenes of a set, and the columns between."""
    evaluation, walls, side = config["evaluation"], config["paper"]["walls"], config["side_walls"]
    data = {**config["paper"], "walls": {**walls, **({"y-": side, "y+": side} if side else {})}}
    columns = {**evaluation["columns"]}
    if between:
        columns |= {name: {"length": size[0], "height": size[1]} for name, size in BETWEEN.items()}
    found = build_scenes(
        columns,
        evaluation["scenes"],
        only=None,
        domain=evaluation["domain"],
        duration=evaluation["duration"],
        interval=config["frame_interval"],
        data=data,
    )
    return list(found.values())


def judged_scenes() -> Iterator[tuple[Scene, Callable[[], Converged]]]:
    """Yield every scene with what gives its reference, which is run where it is not kept."""
    for overrides, between in (
        (("evaluation=general",), False),
        (("side_walls=null",), True),
        ((), True),
    ):
        config = settings(*overrides)
        for scene in scenes_of(config, between=between):
            yield (
                scene,
                partial(
                    converged,
                    scene,
                    mpm=config["choice"]["mpm"],
                    order=config["reference"]["order"],
                    interval=config["frame_interval"],
                    cache=ROOT / config["cache"],
                    **config["reference"][kind_of(scene)],
                ),
            )


def measure(known: list[Row], quantities: list[str]) -> list[Row]:
    """Return all rows, measuring what is not known of these quantities."""
    solvers, records = make_solvers(settings()["choice"]), read_records(RECORDS)
    there = {(row.scene, row.kind, row.of, row.tolerance): row for row in known}
    for scene, reference in judged_scenes():
        runs: dict[str, dict[str, float]] = {}
        options = estimate(scene, solvers, records)
        for of, tolerance in itertools.product(quantities, TOLERANCES):
            key = (scene.name, kind_of(scene), of, tolerance)
            if key not in there or there[key].solver != chosen(options, tolerance, of):
                there[key] = row = judge(scene, reference(), tolerance, of, options, runs)
                what = f"{row.scene} ({row.kind}) {tolerance:g} {of}"
                print(f"{what}: {row.solver or 'none'} {row.error:.3f} {row.outcome}", flush=True)
                write_table(TABLE, Row, there.values(), digits=4)
    return list(there.values())


def chosen(options: Sequence[Option], tolerance: float, of: str) -> str:
    """Return the name of the solver that is taken; "" if none meets the tolerance."""
    try:
        return choose(options, tolerance, of)[0].solver.name
    except InputError:
        return ""


def judge(
    scene: Scene, reference: Converged, tolerance: float, of: str, options: Any, runs: dict[str, dict[str, float]]
) -> Row:
    """Return what becomes of a tolerance; `runs` holds those of solvers that were chosen for the scene before."""
    try:
        option, _ = choose(options, tolerance, of)
    except InputError:
        nothing = dict.fromkeys(("expected", "front_error", "map_error", "expected_seconds", "seconds"), math.nan)
        return Row(scene.name, kind_of(scene), tolerance, "", of=of, **nothing)
    solver = option.solver
    if solver.name not in runs:
        solver.run(scene_of(solver, reference), interval=reference.interval, seed=SEEDS[0])  # compiles
        timed = [timed_run(solver, reference, seed) for seed in SEEDS]
        errors = [reference.errors(made) for made, _, _ in timed]
        names = ("front_error", "map_error", "height_error")
        runs[solver.name] = {name: max((each[name] for each in errors), key=abs) for name in names}
        runs[solver.name]["seconds"] = sum(seconds for _, seconds, _ in timed) / len(timed)
    expected = option.errors.get(of, math.nan)
    time = math.nan if option.seconds is None else option.seconds
    return Row(
        scene.name, kind_of(scene), tolerance, solver.name, expected, expected_seconds=time, of=of, **runs[solver.name]
    )


def tables(rows: list[Row]) -> str:
    """Return choices and outcomes of every quantity that was asked for as Markdown."""
    found = {of: [row for row in rows if row.of == of] for of in (WORSE, *QUANTITIES)}
    return "\n\n".join(table(rows) for rows in found.values() if rows)


def table(rows: list[Row]) -> str:
    """Return choices and outcomes of one quantity as Markdown."""
    names = list(dict.fromkeys((row.kind, row.scene) for row in rows))
    found = {(row.kind, row.scene, row.tolerance): row for row in rows}
    head = ["scene", *(f"{100 * tolerance:g} %" for tolerance in TOLERANCES)]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for kind, scene in names:
        cells = [cell(found[kind, scene, tolerance]) for tolerance in TOLERANCES]
        lines.append(f"| `{scene}`, {'plane strain' if kind == 'plane' else 'space'} | {' | '.join(cells)} |")
    number = {outcome: sum(row.outcome == outcome for row in rows) for outcome in {row.outcome for row in rows}}
    promised = number.get("held", 0) + number.get("broken", 0)
    said = (
        f"**In the {QUANTITIES[rows[0].of]} the promise held in {number.get('held', 0)} of {promised} cases.** "
        f"{number.get('refused', 0)} tolerances were refused as below what any solver reaches"
    )
    free = number.get("unpromised, within", 0) + number.get("unpromised, beyond", 0)
    if free:
        said += f"; where no error was promised, {number.get('unpromised, within', 0)} of {free} were within it"
    return "\n".join([f"{said}.", "", *lines])


def cell(row: Row) -> str:
    """Return an outcome in a table's cell."""
    if not row.solver:
        return "refused"
    mark = {"held": "", "broken": "**broken** "}.get(row.outcome, "(no promise) ")
    return f"{mark}`{row.solver}` {100 * row.error:.1f} %"


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from-table", action="store_true", help="measure nothing")
    parser.add_argument("--of", nargs="+", choices=QUANTITIES, default=[WORSE], help="quantities of the tolerances")
    asked = parser.parse_args()
    known = read_table(TABLE, Row, "is no table of promises") if TABLE.exists() else []
    rows = known if asked.from_table else measure(known, asked.of)
    text = PAGE.read_text(encoding="utf-8")
    marked = re.compile(r"(<!-- promise -->\n).*?(\n<!-- /promise -->)", re.DOTALL)
    if not marked.search(text):
        raise SystemExit(f"{PAGE}: has no <!-- promise --> to fill.")
    PAGE.write_text(marked.sub(lambda match: match[1] + tables(rows) + match[2], text), encoding="utf-8")


if __name__ == "__main__":
    main()
