"""What every reduction costs in accuracy and saves in time: columns by every way, against fine MPM.

    python benchmarks/reductions.py                  # as in docs/reductions.md; the fine runs take minutes and are kept
    python benchmarks/reductions.py --threads 1 --kinds plane --columns 0.8 2.0
    python benchmarks/reductions.py --learned a.ckpt b.ckpt --corrected c.corrector --out mine.csv   # one's own
    python benchmarks/reductions.py --records src/gns_pl/solvers/records.csv   # what simulate.py tolerance=… knows

Columns of a = 0.8, 1.2, 2.0 and 3.0 stand between smooth side walls ("plane", plane strain) and between the paper's
rough ones ("space"). The reference is MPM on cells of 1/48 m: in three dimensions for a = 0.8 and 2.0, else on the
slice or half that gives the same. Times are medians of warm runs: neighbours, network, integration and copies are in
them, compilation and files are not. Errors are relative, the largest of the placements beside mean and standard
deviation of the runout's; "curve" is the mean absolute difference of the 99 % runout over time, over its final value.
"extrapolated" takes the runout, and nothing else, linearly in the cell from two MPM runs. Rows that a table has of
other kinds, columns and threads stay in it. `benchmark.py` charts more settings, all in turns, with what they cost
before; this table has what sleeps and rests, and both kinds at once.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import re
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numba
import numpy as np
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from gns_pl.evaluation.chart.converged import Converged, errors_of
from gns_pl.generation.reference import reference_trajectory
from gns_pl.io.tables import write_table
from gns_pl.scene import Material, Scene, Wall, column_collapse, part_from_dict
from gns_pl.scene.extent import characteristic_time
from gns_pl.solvers.catalogue import make_solvers
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.measured_range import setup_text
from gns_pl.solvers.reduction import Reduction, reduce_scene
from gns_pl.solvers.selection import Record
from gns_pl.solvers.solver import MPMSolver, Solver
from gns_pl.solvers.trivial import extrapolate
from gns_pl.trajectory import Trajectory

COLUMNS = {  # a: L0, H0, box [m]
    "0.8": (0.475, 0.38, (1.5, 0.5, 0.7)),
    "1.2": (0.35, 0.42, (2.5, 0.5, 1.1)),
    "2.0": (0.30, 0.60, (1.5, 0.5, 0.7)),
    "3.0": (0.25, 0.75, (2.5, 0.5, 1.1)),
}
INTERVAL, DURATION = 0.02, 6.0  # s between frames compared; τc
HEAD = (
    f"{'way':24} {'N':>7} {'runout':>7} {'error':>8} {'mean':>8} {'std':>6} {'curve':>7} {'height':>8} {'profile':>8} "
    f"{'s':>8} {'faster':>7}"
)


@dataclass(frozen=True)
class Row(Record):
    """A record, with what the way gave.

    Attributes:
        runout: final, 99 % [L0].
        times_faster: than the reference on as many threads.
        mean_error: of the runout, over the placements.
        scatter: standard deviation of the same.
    """

    runout: float
    times_faster: float
    mean_error: float = float("nan")
    scatter: float = float("nan")


def column(name: str, kind: str, paper: dict[str, object]) -> Scene:
    """Return a column of the paper's sand."""
    length, height, domain = COLUMNS[name]
    walls = {face: part_from_dict(Wall, face, wall) for face, wall in paper["walls"].items()}
    if kind == "plane":
        walls |= {"y-": Wall("slip"), "y+": Wall("slip")}
    scene = column_collapse(
        domain=domain, length=length, height=height, gravity=paper["gravity"], duration=1.0,
        material=part_from_dict(Material, "material", paper["material"]), walls=walls, name=f"column_{name}",
    )  # fmt: skip
    return scene.replace(duration=INTERVAL * np.ceil(DURATION * characteristic_time(scene) / INTERVAL))


def timed(run: Callable[[], Trajectory], turns: int) -> tuple[Trajectory, float]:
    """Return the last result and the median time of warm runs; slow ones are warm after what was compiled for them."""
    began = time.perf_counter()
    made = run()
    first = time.perf_counter() - began
    times = []
    for _ in range(turns if first < 20 else 1):
        began = time.perf_counter()
        made = run()
        times.append(time.perf_counter() - began)
    return made, statistics.median(times)


def main() -> None:
    """Measure, print, and write tables if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", nargs="+", default=list(COLUMNS), choices=list(COLUMNS))
    parser.add_argument("--kinds", nargs="+", default=["plane", "space"], choices=["plane", "space"])
    parser.add_argument("--threads", type=int, nargs="+", default=[2])
    parser.add_argument("--core", type=int, default=0, help="the first of those it is bound to")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=6, help="placements; errors are of each, the first one's is timed")
    parser.add_argument("--learned", nargs="*", help="checkpoints; those of conf/simulate.yaml if left out")
    parser.add_argument("--corrected", nargs="*", help="correctors, likewise")
    parser.add_argument(
        "--rest-speed", type=float, default=0.02, help="of the variants that sleep and end at rest, m/s"
    )
    parser.add_argument("--cache", type=Path, default=Path("runs/references"))
    parser.add_argument("--out", type=Path, help="CSV file of all rows")
    parser.add_argument("--records", type=Path, help="CSV file of the package's ways alone")
    args = parser.parse_args()
    with initialize_config_dir(str(Path(__file__).parents[1] / "conf"), version_base=None):
        config = OmegaConf.to_container(compose("simulate"), resolve=True)
    choice, paper = config["choice"], config["paper"]
    learned = choice["learned"] if args.learned is None else args.learned
    corrected = choice["corrected"] if args.corrected is None else args.corrected
    ways = make_solvers(learned, corrected, choice["handed"], choice["cells"], choice["mpm"])
    own = {way.name for way in ways}
    simulators = [way for way in ways if type(way) is LearnedSolver and way.name in choice["learned"]]
    extra: list[Solver] = [replace(way, name=f"{way.name}+rest", rest_speed=args.rest_speed) for way in simulators]
    extra += [
        replace(way, name=f"{way.name}+sleep", rest_speed=args.rest_speed, stabilise={"sleep": args.rest_speed})
        for way in simulators
    ]
    solvers = [way for way in ways if isinstance(way, MPMSolver)]
    extra += [replace(way, name=f"{way.name} whole", reduces=False) for way in solvers[:3]]
    device = f"{platform.machine()} CPU"
    print(f"{device}, torch {torch.__version__}, turns {args.turns}, {args.seeds} placements")
    again = {(kind, f"column_{name}", n) for kind in args.kinds for name in args.columns for n in args.threads}
    rows = [row for row in read(args.out) if (row.kind, row.scene, row.threads) not in again]
    for threads in args.threads:
        os.sched_setaffinity(0, range(args.core, args.core + threads))
        torch.set_num_threads(threads)
        numba.set_num_threads(threads)
        for kind in args.kinds:
            for name in args.columns:
                scene = column(name, kind, paper)
                whole = kind == "plane" and name in ("0.8", "2.0")
                reduced = Reduction(scene, lambda made: made, "") if whole else reduce_scene(scene)
                settings = {**choice["mpm"], "cell_size": 1 / 48}
                kept = args.cache / f"threads_{threads}"
                fine = reference_trajectory(
                    reduced.scene, settings, frame_interval=INTERVAL, seed=0, cache_directory=kept
                )
                reference_seconds = float(fine.provenance["wall_seconds"])
                judged = Converged.by(
                    [reduced.lift(fine)], scene, flat=scene, uncertainty=float("nan"), identity="", words="1/48 m"
                )
                wanted = judged.facts.runout
                print(
                    f"\n{kind}, a = {name}, {threads} threads: {wanted:.3f} L0 by 1/48 m in {reference_seconds:.1f} s"
                )
                print(HEAD)
                of_cell: dict[float, list[Row]] = {}
                for way in [*ways, *extra]:
                    if way.unsupported_reason(scene):
                        continue

                    def run(seed: int, way: Solver = way, scene: Scene = scene) -> Trajectory:
                        return way.run(scene, interval=INTERVAL, seed=seed)

                    made, seconds = timed(lambda run=run: run(0), args.turns)
                    particles = way.size(scene)[0]
                    seeds = args.seeds if seconds < 2 else min(args.seeds, 3)
                    others = [run(seed) for seed in range(1, seeds)] if seconds < 20 else []
                    found = [errors_of(each, judged) for each in (made, *others)]
                    worst = {key: max((each[key] for each in found), key=abs) for key in found[0]}
                    mean = {key: statistics.mean(each[key] for each in found) for key in found[0]}
                    row = Row(
                        way=way.name, kind=kind, scene=scene.name, seconds=seconds, work=way.work(scene),
                        particles=particles, threads=threads, device=device, setup=setup_text(scene),
                        times_faster=reference_seconds / seconds, mean_error=mean["runout_error"],
                        scatter=statistics.pstdev(each["runout_error"] for each in found),
                        **(worst | {"runout": mean["runout"]}),
                    )  # fmt: skip
                    rows.append(row)
                    if isinstance(way, MPMSolver) and "whole" not in way.name:
                        of_cell[way.cells] = [row]
                    show(row)
                for coarse, finer in ((0, 1), (1, 2), (0, 2)):
                    pair = [of_cell[key][0] for key in sorted(of_cell)]
                    cells = sorted(of_cell)
                    a, b, h, k = pair[coarse], pair[finer], 1 / cells[coarse], 1 / cells[finer]
                    runout = extrapolate(a.runout, b.runout, h / k)
                    nothing = float("nan")
                    row = replace(
                        b, way=f"extrapolated {cells[coarse]:g} {cells[finer]:g}", runout=runout,
                        runout_error=runout / wanted - 1, curve_error=nothing, height_error=nothing,
                        profile_error=nothing, mean_error=runout / wanted - 1, scatter=nothing,
                        seconds=a.seconds + b.seconds,
                        times_faster=reference_seconds / (a.seconds + b.seconds),
                    )  # fmt: skip
                    rows.append(row)
                    show(row)
                if args.out:
                    write(args.out, rows, Row)
                    draw(rows, args.out.with_suffix(".png"))
    if args.records:
        write(args.records, [row for row in rows if row.way in own], Record)


def draw(rows: list[Row], path: Path) -> None:
    """Draw the largest error of all columns against the time of a run, a panel for each kind, into a file."""
    import matplotlib.pyplot as plt

    kinds = list(dict.fromkeys(row.kind for row in rows))
    figure, axes = plt.subplots(1, len(kinds), figsize=(6 * len(kinds), 4.6), layout="constrained", squeeze=False)
    titles = {"plane": "smooth side walls (plane strain)", "space": "rough side walls"}
    for axis, kind in zip(axes[0], kinds, strict=True):
        points: dict[str, list[Row]] = {}
        for row in rows:
            if row.kind == kind and "+" not in row.way:  # what sleeps or ends at rest lies on what does not
                points.setdefault(row.way, []).append(row)
        of_mpm = []
        for way, found in points.items():
            seconds = statistics.median(row.seconds for row in found)
            error = max(100 * max(abs(row.runout_error) for row in found), 1.0)
            solver, guessed = bool(re.match(r"mpm_\d", way)), way.startswith("extrapolated")
            colour = "C7" if guessed else "C0" if solver else "C1" if way.startswith("corrected") else "C2"
            axis.plot(seconds, error, "x" if guessed else "o", color=colour)
            cells = [str(round(0.4243 / float(part) * 1e3)) for part in re.findall(r"[\d.]+", way)]
            label = f"MPM {cells[0]} mm{' whole' if 'whole' in way else ''}" if solver else way
            label = f"extrapolated {cells[0]}, {cells[1]}" if guessed else label
            axis.annotate(label, (seconds, error), xytext=(4, 3), textcoords="offset points", fontsize=7)
            if solver and "whole" not in way:
                of_mpm.append((seconds, error))
        axis.plot(*zip(*sorted(of_mpm), strict=True), color="C0", linewidth=0.8)
        axis.axhline(5, color="0.7", linewidth=0.8, linestyle="--")
        axis.set(xscale="log", yscale="log", xlabel="wall time of a run [s]", title=titles[kind])
        axis.set(ylabel="largest error of the final 99 % runout [%], at least 1", ylim=(0.8, 60))
        axis.margins(x=0.25)
        axis.grid(alpha=0.3, which="both")
    figure.savefig(path, dpi=130)


def show(row: Row) -> None:
    """Print a row."""
    percent = f"{100 * row.runout_error:+7.1f}% {100 * row.mean_error:+7.1f}% {100 * row.scatter:5.1f}% "
    percent += f"{100 * row.curve_error:6.1f}% {100 * row.height_error:+7.1f}%"
    print(
        f"{row.way:24} {row.particles:7} {row.runout:7.3f} {percent} {row.profile_error:8.3f} {row.seconds:8.3f} "
        f"{row.times_faster:7.1f}",
        flush=True,
    )


def read(path: Path | None) -> list[Row]:
    """Return the rows of a table that is there; what older ones lack is NaN."""
    if path is None or not path.exists():
        return []
    types = {"int": int, "float": float, "str": str}
    with path.open(newline="") as file:
        return [
            Row(**{each.name: types[str(each.type)](row[each.name]) for each in fields(Row) if each.name in row})
            for row in csv.DictReader(file)
        ]


def write(path: Path, rows: list[Row], kind: type) -> None:
    """Write a table of a kind's fields."""
    write_table(path, kind, rows)


if __name__ == "__main__":
    main()
