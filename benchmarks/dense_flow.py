"""AvaFrame's dense flow (com1DFA) on an idealised slope beside depth-averaged flow and MPM: a table of docs/terrain.md.

    pip install avaframe                                    # 2.1; into another environment, if you like
    python benchmarks/dense_flow.py                         # what docs/dense_flow.csv lacks; and into docs/terrain.md
    python benchmarks/dense_flow.py --avaframe ava/bin/python   # AvaFrame of another interpreter
    python benchmarks/dense_flow.py --from-table            # write the page's table again; nothing is run

A block lies on a plane that runs out on flat ground, with Coulomb friction alone: the friction that all three know.
AvaFrame is no part of this package and of none of its extras: its solver is started as a program of its own, of files
that this script writes, and its rasters are read. com1DFA measures thickness normal to the ground, so its release is
thinner by cos θ, and its maps are divided by the cosine of the ground's slope.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TABLE, PAGE = ROOT / "docs" / "dense_flow.csv", ROOT / "docs" / "terrain.md"
SLOPE_DEG, FRICTION, CELL, SIZE, TOE = 28.0, 0.3, 5.0, (900.0, 300.0), (300.0, 60.0)
RELEASE, THICKNESS = ((60.0, 110.0), (140.0, 190.0)), 6.0  # corners and vertical thickness [m]
DURATION, INTERVAL, REACHED = 60.0, 0.5, 0.3  # s, s, m
GAUGE = 420.0  # x of a line across the flat on which the arrival is measured [m]
AVAFRAME = "AvaFrame"
SOLVERS = {"shallow-k0": {}, "shallow": {}, "mpm": {"cell_size": 3.0}}


@dataclass(frozen=True)
class Row:
    """What a solver makes of the slope.

    Attributes:
        solver: its name.
        runout: farthest x that was thicker than `REACHED` [m].
        width: of what was reached, along y [m].
        area: reached [m²].
        max_thickness: largest thickness on the flat at any time, vertical [m].
        deposit: largest thickness of the end [m].
        centre: x of the deposit's centre of mass [m].
        arrival: when the flow was first thicker than `REACHED` at x = `GAUGE` [s].
        max_velocity: largest, of cells that are reached; NaN where it is not known [m/s].
        volume: of the deposit over that of the release.
        cpu_seconds: processor time of the run.
    """

    solver: str
    runout: float
    width: float
    area: float
    max_thickness: float
    deposit: float
    centre: float
    arrival: float
    max_velocity: float
    volume: float
    cpu_seconds: float


def make_scene() -> Any:
    """Return the slope as a scene."""
    from gns_pl.scene import scene_from_dict

    (left, low), (right, up) = RELEASE
    return scene_from_dict(
        {
            "name": "dense_flow",
            "gravity": [0.0, 0.0, -9.81],
            "duration": DURATION,
            "materials": {
                "sand": {"density": 2000.0, "youngs_modulus": 1e7, "poisson_ratio": 0.3, "friction_angle_deg": 32.0}
            },
            "terrain": {
                "shape": "slope", "size": list(SIZE), "cell": CELL, "slope_deg": SLOPE_DEG, "toe": list(TOE),
                "wall": {"condition": "friction", "friction": FRICTION},
            },
            "bodies": [{"outline": [[[left, low], [right, low], [right, up], [left, up]]], "thickness": THICKNESS}],
            "walls": {face: {"condition": "slip"} for face in ("x-", "x+", "y-", "y+", "z-", "z+")},
        }
    )  # fmt: skip


def row_of(name: str, grid: Any, maps: dict[str, Any], cpu_seconds: float) -> Row:
    """Return what maps [X, Y] say: largest thickness and velocity, deposit, arrival time."""
    import numpy as np

    x, y = grid.centres
    reached, area = maps["max_thickness"] >= REACHED, grid.cell**2
    deposit = maps["deposit"]
    left, across = x[reached.any(axis=1)], y[reached.any(axis=0)]
    flat = x > sum(TOE)
    gauge = maps["arrival_time"][np.abs(x - GAUGE).argmin()]
    velocity = maps.get("max_velocity")
    (low, high), (right, up) = RELEASE
    return Row(
        solver=name,
        runout=float(left.max() + grid.cell / 2),
        width=float(np.ptp(across) + grid.cell),
        area=float(reached.sum() * area),
        max_thickness=float(maps["max_thickness"][flat].max()),
        deposit=float(deposit.max()),
        centre=float((deposit.sum(axis=1) @ x) / deposit.sum()),
        arrival=float(np.nanmin(gauge)) if np.isfinite(gauge).any() else math.nan,
        max_velocity=math.nan if velocity is None else float(np.where(reached, velocity, 0.0).max()),
        volume=float(deposit.sum() * area / ((right - low) * (up - high) * THICKNESS)),
        cpu_seconds=cpu_seconds,
    )


def run_own(name: str, options: dict[str, Any]) -> Row:
    """Run one of this package's solvers, once for what is compiled in it and once for its time."""
    from gns_pl.evaluation.maps import maps_of
    from gns_pl.solvers.catalogue import load_solver

    scene, solver = make_scene(), load_solver(name, **options)
    solver.run(scene.replace(duration=2 * INTERVAL), interval=INTERVAL)
    began = time.process_time()
    run = solver.run(scene, interval=INTERVAL)
    seconds = time.process_time() - began
    maps = maps_of(run, reached=REACHED)
    label = f"{name}, cells of {options['cell_size']:g} m" if options else name
    return row_of(label, maps.grid, maps.rasters(), seconds)


def run_avaframe(python: str) -> Row:
    """Run com1DFA in another process, and read its rasters."""
    import numpy as np

    from gns_pl.io.raster import write_raster
    from gns_pl.metrics.rasters import map_grid
    from gns_pl.scene import read_raster

    scene = make_scene()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "slope"
        (folder / "Inputs" / "REL").mkdir(parents=True)
        (folder / "Inputs" / "CFGs").mkdir()
        write_raster(folder / "Inputs" / "slope", scene.terrain.raster)
        for extra in (folder / "Inputs").glob("slope.tif"):
            extra.unlink()  # it takes one elevation model alone
        ask = [python, str(Path(__file__).resolve()), "--inside", str(folder)]
        made = subprocess.run(ask, capture_output=True, text=True, check=False)
        if made.returncode:
            raise SystemExit(f"{python}: com1DFA did not run; is avaframe installed there?\n{made.stderr[-2000:]}")
        told = json.loads(made.stdout.splitlines()[-1])
        grid = map_grid(scene, CELL)
        values = {key: np.nan_to_num(read_raster(Path(path)).values) for key, path in told["files"].items()}
        frames = [(when, np.nan_to_num(read_raster(Path(path)).values)) for when, path in told["frames"]]
    slope = np.hypot(*np.gradient(scene.terrain.heights, CELL))
    upright = np.sqrt(1 + slope**2)
    maps = {key: values[key] * upright for key in ("max_thickness", "deposit")}
    maps |= {"max_velocity": values["max_velocity"]}
    arrival = np.full(upright.shape, np.nan)
    for (before, old), (after, new) in itertools.pairwise((when, thick * upright) for when, thick in frames):
        there = np.isnan(arrival) & (new >= REACHED)
        part = np.clip((REACHED - old) / np.where(new > old, new - old, 1.0), 0.0, 1.0)
        arrival[there] = (before + part * (after - before))[there]
    maps["arrival_time"] = arrival
    return row_of(f"{AVAFRAME} {told['version']} com1DFA", grid, maps, told["cpu_seconds"])


def inside(folder: Path) -> None:
    """Run com1DFA here, where AvaFrame is installed, and print where its rasters are; gns_pl is not needed."""
    import resource
    from importlib.metadata import version

    import shapefile
    from avaframe.com1DFA import com1DFA
    from avaframe.in3Utils import cfgUtils, logUtils
    from avaframe.in3Utils import initializeProject as project

    project.initializeFolderStruct(str(folder), removeExisting=False)
    (left, low), (right, up) = RELEASE
    with shapefile.Writer(str(folder / "Inputs" / "REL" / "release")) as release:
        release.field("name", "C")
        release.field("thickness", "N", decimal=6)
        release.field("ci95", "N", decimal=6)
        ring = [[left, low], [left, up], [right, up], [right, low], [left, low]]
        release.poly([ring])
        release.record("release", THICKNESS * math.cos(math.radians(SLOPE_DEG)), 0.0)
    main = cfgUtils.getGeneralConfig()
    main["MAIN"]["avalancheDir"] = str(folder)
    main["MAIN"]["nCPU"] = "1"
    main["FLAGS"]["savePlot"] = main["FLAGS"]["createReport"] = "False"
    logUtils.initiateLogger(str(folder), "log")
    config = cfgUtils.getModuleConfig(com1DFA, str(folder), toPrint=False)
    settings = {
        "simTypeList": "null",
        "resType": "pft|pfv|FT",
        "tSteps": f"0:{INTERVAL:g}",
        "rho": "2000",
        "frictModel": "Coulomb",
        "mucoulomb": str(FRICTION),
        "meshCellSize": str(CELL),
        "sphKernelRadius": str(CELL),
        "tEnd": str(DURATION),
    }

    config["GENERAL"].update(settings)

    def spent() -> float:
        return sum(
            use.ru_utime + use.ru_stime
            for use in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        )

    began = spent()
    com1DFA.com1DFAMain(main, cfgInfo=config)
    seconds = spent() - began
    peaks = folder / "Outputs" / "com1DFA" / "peakFiles"
    names = {"max_thickness": "pft", "max_velocity": "pfv"}
    files = {key: str(next(peaks.glob(f"*_{name}.*"))) for key, name in names.items()}
    found = (peaks / "timeSteps").glob("*_FT_t*")
    frames = sorted((float(path.stem.rsplit("_t", 1)[1]), str(path)) for path in found)
    files["deposit"] = frames[-1][1]
    print(json.dumps({"files": files, "frames": frames, "cpu_seconds": seconds, "version": version("avaframe")}))


def page_table(rows: list[Row]) -> str:
    """Return the rows as Markdown."""
    lines = [
        "| solver | runout, x [m] | width [m] | area [ha] | thickest on the flat [m] | deposit [m] | middle, x [m] | "
        f"arrival at {GAUGE:g} m [s] | fastest [m/s] | processor time [s] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        fastest = "–" if math.isnan(row.max_velocity) else f"{row.max_velocity:.1f}"
        lines.append(
            f"| {row.solver} | {row.runout:.0f} | {row.width:.0f} | {row.area / 1e4:.2f} | {row.max_thickness:.2f} | "
            f"{row.deposit:.2f} | {row.centre:.0f} | {row.arrival:.1f} | {fastest} | {row.cpu_seconds:.2g} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run what is wanted and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--avaframe", metavar="PYTHON", default=sys.executable, help="interpreter that has AvaFrame")
    parser.add_argument("--from-table", action="store_true", help="run nothing")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.inside:
        inside(arguments.inside)
        return
    from gns_pl.io.tables import read_table, write_table

    rows = read_table(TABLE, Row, "is no table of this script") if TABLE.exists() else []
    for name in () if arguments.from_table else (AVAFRAME, *SOLVERS):
        if not any(re.match(rf"{name}( |,|$)", row.solver) for row in rows):
            new = run_avaframe(arguments.avaframe) if name == AVAFRAME else run_own(name, SOLVERS[name])
            print(asdict(new), flush=True)
            rows = [new, *rows] if name == AVAFRAME else [*rows, new]
            write_table(TABLE, Row, rows, 4)
    text = PAGE.read_text(encoding="utf-8")
    marked = re.compile(r"(<!-- dense_flow -->\n).*?(\n<!-- /dense_flow -->)", re.DOTALL)
    if not marked.search(text):
        raise SystemExit(f"{PAGE}: has no <!-- dense_flow --> to fill.")
    PAGE.write_text(marked.sub(lambda match: match[1] + page_table(rows) + match[2], text), encoding="utf-8")


if __name__ == "__main__":
    main()
