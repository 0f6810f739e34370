"""One landslide on a real slope by several solvers, side by side: the table and the figure of docs/terrain.md.

    python examples/terrain_solvers.py runs/solvers                         # minutes; table, figure and scene there
    python examples/terrain_solvers.py runs/solvers --solvers mpm shallow-k0 mpm-retuned-5
    python examples/terrain_solvers.py runs/solvers --publish               # and into docs/
    python examples/terrain_solvers.py runs/solvers --scene mine.yaml --reached 0.5

The scene is that of examples/terrain.py. A solver is any name that `simulate.py solver=` takes; `mpm` runs on cells of
--cell-size metres. What each makes of the scene is measured in the same way, on the terrain's own cells.
"""

from __future__ import annotations

import argparse
import math
import re
import runpy
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gns_pl.metrics.rasters import FlowMaps
    from gns_pl.scene import Scene
    from gns_pl.trajectory import Trajectory

DOCS = Path(__file__).parents[1] / "docs"
TABLE, FIGURE = "terrain_solvers.csv", "terrain_solvers.png"
SOLVERS = ("shallow-k0", "shallow", "ground", "mpm-retuned-5", "mpm")
GROUND = 25.0  # cells of the example's ground [m]
COLOURS = ("#000000", "#D55E00", "#009E73", "#CC79A7", "#56B4E9")


@dataclass(frozen=True)
class Row:
    """What a solver makes of the scene.

    Attributes:
        solver: its name.
        runout: horizontal distance from the release within which 99 % of the mass lies at the end [m].
        area: of all that was reached [m²].
        max_thickness: largest thickness at any time [m].
        deposit: largest thickness at the end [m].
        centre: horizontal distance between the first and the last centre of mass [m].
        path: length of its way, horizontal [m].
        drop: by how much it came down [m].
        max_velocity: largest, mean over the thickness [m/s].
        moving: share of the largest kinetic energy that is left at the end; NaN of particles that show a layer.
        cpu_seconds: processor time of the run.
    """

    solver: str
    runout: float
    area: float
    max_thickness: float
    deposit: float
    centre: float
    path: float
    drop: float
    max_velocity: float
    moving: float
    cpu_seconds: float


def run_solver(name: str, scene: Scene, cell_size: float, interval: float) -> tuple[Trajectory, float]:
    """Return a run, and its processor time without compilation [s]."""
    from gns_pl.solvers.catalogue import load_solver

    solver = load_solver(name, cell_size=cell_size if name == "mpm" else None)
    solver.run(scene.replace(duration=interval), interval=interval)
    began = time.process_time()
    run = solver.run(scene, interval=interval)
    return run, time.process_time() - began


def measure(name: str, run: Trajectory, reached: float, seconds: float) -> tuple[Row, FlowMaps]:
    """Return the row of a run, and its maps."""
    from gns_pl.metrics.curves import mobile
    from gns_pl.metrics.measures import centre_of_mass, kinetic_energy
    from gns_pl.metrics.rasters import compute_maps, shows_motion
    from gns_pl.metrics.release import front_advance

    flow = mobile(run)
    maps, centre, energy = compute_maps(flow, reached=reached), centre_of_mass(flow), kinetic_energy(flow)
    row = Row(
        solver=name,
        runout=float(front_advance(flow)[-1]),
        area=maps.area(),
        max_thickness=float(maps.max_thickness.max()),
        deposit=float(maps.deposit.max()),
        centre=float(np.linalg.norm(centre[-1, :2] - centre[0, :2])),
        path=float(np.linalg.norm(np.diff(centre[:, :2], axis=0), axis=1).sum()),
        drop=float(centre[0, 2] - centre[-1, 2]),
        max_velocity=math.nan if maps.max_velocity is None else float(maps.max_velocity.max()),
        moving=float(energy[-1] / energy.max()) if shows_motion(flow) else math.nan,
        cpu_seconds=seconds,
    )
    return row, maps


def draw(path: Path, scene: Scene, found: dict[str, FlowMaps]) -> None:
    """Draw the deposits side by side over the shaded ground, with the outlines of all runs in every panel."""
    from gns_pl.viz.ground import ground_height
    from gns_pl.viz.maps import RELEASE, Layer, Line, plot_map

    first = next(iter(found.values()))
    most = max(float(maps.deposit.max()) for maps in found.values())
    shown = [
        Layer(np.where(maps.deposit >= maps.reached, maps.deposit, np.nan), f"{name}: deposit [m]", limits=(0.0, most))
        for name, maps in found.items()
    ]
    outlines = [
        Line(maps.max_thickness, maps.reached, f"{name}: reached {maps.reached:g} m", colour)
        for (name, maps), colour in zip(found.items(), COLOURS, strict=False)
    ]
    outlines.append(Line(first.release, first.reached, "release", RELEASE, "--"))
    ground = ground_height(scene, first.grid) + scene.origin[2]
    plot_map(shown, outlines, first.grid, ground, [path], origin=(scene.origin[0], scene.origin[1]))


def page_table(rows: list[Row]) -> str:
    """Return the rows as Markdown."""
    lines = [
        "| solver | runout, 99 % [m] | reached [ha] | thickest [m] | deposit [m] | centre: distance, path, drop [m] | "
        "fastest [m/s] | energy left | processor time [s] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        left = "–" if math.isnan(row.moving) else f"{100 * row.moving:.1f} %"
        lines.append(
            f"| `{row.solver}` | {row.runout:.0f} | {row.area / 1e4:.1f} | {row.max_thickness:.1f} | {row.deposit:.1f} "
            f"| {row.centre:.0f}, {row.path:.0f}, {row.drop:.0f} | {row.max_velocity:.0f} | {left} "
            f"| {row.cpu_seconds:.2g} |"
        )
    return "\n".join(lines)


def publish(folder: Path, rows: list[Row]) -> None:
    """Copy table and figure into docs/, and put the rows between the marks of its page."""
    (DOCS / TABLE).write_bytes((folder / TABLE).read_bytes())
    (DOCS / "figures" / FIGURE).write_bytes((folder / FIGURE).read_bytes())
    page = DOCS / "terrain.md"
    marked = re.compile(r"(<!-- solvers -->\n).*?(\n<!-- /solvers -->)", re.DOTALL)
    text = page.read_text(encoding="utf-8")
    page.write_text(marked.sub(lambda match: match[1] + page_table(rows) + match[2], text), encoding="utf-8")


def main() -> None:
    """Run all solvers, one after the other."""
    from gns_pl.io.tables import read_table, write_table
    from gns_pl.scene import read_scene
    from gns_pl.scene.extent import frame_interval_of

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS))
    parser.add_argument("--scene", type=Path, help="another scene on a terrain; the example's otherwise")
    parser.add_argument("--cell-size", type=float, default=25.0, help="of mpm [m]")
    parser.add_argument("--reached", type=float, default=1.0, help="thickness from which on a cell is reached [m]")
    parser.add_argument("--publish", action="store_true", help="write into docs/, too")
    parser.add_argument("--from-table", action="store_true", help="run nothing, publish what the folder holds")
    asked = parser.parse_args()
    folder: Path = asked.folder
    if asked.from_table:
        publish(folder, read_table(folder / TABLE, Row, "is no table of this example"))
        return
    if asked.scene is None:
        runpy.run_path(str(Path(__file__).with_name("terrain.py")))["write_scene"](folder, GROUND)
    folder.mkdir(parents=True, exist_ok=True)
    scene = read_scene(asked.scene or folder / "landslide.yaml")
    rows, found = [], {}
    for name in asked.solvers:
        run, seconds = run_solver(name, scene, asked.cell_size, frame_interval_of(scene))
        row, found[name] = measure(name, run, asked.reached, seconds)
        rows.append(row)
        print(row, flush=True)
    write_table(folder / TABLE, Row, rows, 4)
    draw(folder / FIGURE, scene, found)
    print(page_table(rows), folder / FIGURE, sep="\n")
    if asked.publish:
        publish(folder, rows)


if __name__ == "__main__":
    main()
