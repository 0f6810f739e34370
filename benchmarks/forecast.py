"""The time said before a run on a terrain, and what it then took: docs/forecast.csv, and a table of docs/terrain.md.

    python benchmarks/forecast.py                # measure what the table lacks; write into docs/terrain.md
    python benchmarks/forecast.py --from-table   # write the page's table again; nothing is run

Times are processor times of one thread, without the loading of compiled code (`forecast.START`). The numbers by which
a time is said (`gns_pl.solvers.forecast`) are fitted to these runs by hand.
"""

from __future__ import annotations

import argparse
import re
import runpy
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TABLE, PAGE = ROOT / "docs" / "forecast.csv", ROOT / "docs" / "terrain.md"

CASES: Mapping[str, tuple[str, str, float | None, float, float]] = {
    "lab, mpm_7.64, 41 frames": ("runout", "mpm_7.64", None, 0.4, 0.01),
    "lab, mpm_7.64, 401 frames": ("runout", "mpm_7.64", None, 0.4, 0.001),
    "hill, MPM on 4 m": (str(ROOT / "scenes/landslide.yaml"), "mpm", 4.0, 3.0, 0.5),
    "example, MPM on 25 m": ("25", "mpm", 25.0, 10.0, 0.5),
    "example, MPM on 16 m": ("25", "mpm", 16.0, 2.0, 0.5),
    "lab, shallow-k0, 51 frames": ("runout", "shallow-k0", None, 0.5, 0.01),
    "lab, shallow-k0, 251 frames": ("runout", "shallow-k0", None, 0.5, 0.002),
    "example, shallow-k0 on 25 m": ("25", "shallow-k0", None, 30.0, 0.5),
}
"""Name → scene (number: cells of the example's ground [m]), solver, its cells [m], duration and frame interval [s]."""


@dataclass(frozen=True)
class Row:
    """A run that was measured.

    Attributes:
        case: key of `CASES`.
        particles: of the run.
        seconds: processor time [s].
    """

    case: str
    particles: int
    seconds: float


def prepared(case: str) -> tuple[Any, Any, float]:
    """Return scene, solver and frame interval of a case."""
    from gns_pl.scene import read_scene
    from gns_pl.solvers.catalogue import load_solver

    name, solver, cell_size, duration, interval = CASES[case]
    if name.isdigit():
        with tempfile.TemporaryDirectory() as folder:
            runpy.run_path(str(ROOT / "examples" / "terrain.py"))["write_scene"](Path(folder), float(name))
            scene = read_scene(Path(folder) / "landslide.yaml")
    else:
        scene = read_scene(name)
    return scene.replace(duration=duration), load_solver(solver, cell_size=cell_size), interval


def measure(case: str) -> Row:
    """Run a case, after a frame of it that loads what is compiled."""
    scene, solver, interval = prepared(case)
    solver.run(scene.replace(duration=interval), interval=interval)
    began = time.process_time()
    run = solver.run(scene, interval=interval)
    return Row(case, run.num_particles, time.process_time() - began)


def page_table(rows: list[Row]) -> str:
    """Return what was said and what was measured as Markdown."""
    from gns_pl.solvers.forecast import START, needs_of

    lines = ["| run | particles | frames | said [s] | measured [s] |", "|---|---|---|---|---|"]
    for row in rows:
        scene, solver, interval = prepared(row.case)
        needs = needs_of(solver, scene, interval)
        assert needs is not None
        frames = round(scene.duration / interval) + 1
        lines.append(f"| {row.case} | {row.particles:,} | {frames} | {needs.seconds - START:.2g} | {row.seconds:.2g} |")
    return "\n".join(lines)


def main() -> None:
    """Measure and write."""
    from gns_pl.io.tables import read_table, write_table

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--from-table", action="store_true", help="measure nothing")
    known = read_table(TABLE, Row, "is no table of this script") if TABLE.exists() else []
    there = {row.case: row for row in known if row.case in CASES}
    for case in () if parser.parse_args().from_table else CASES:
        if case not in there:
            there[case] = measure(case)
            print(there[case], flush=True)
            write_table(TABLE, Row, there.values(), 3)
    text = PAGE.read_text(encoding="utf-8")
    marked = re.compile(r"(<!-- forecast -->\n).*?(\n<!-- /forecast -->)", re.DOTALL)
    table = page_table([there[case] for case in CASES if case in there])
    PAGE.write_text(marked.sub(lambda match: match[1] + table + match[2], text), encoding="utf-8")


if __name__ == "__main__":
    main()
