"""What the jobs of a sweep are worth on columns that none of them saw: runs of each job's best weights beside MPM.

    python benchmarks/sweep_columns.py runs/cube106_sweeps/noise …            # judge what is missing, write the tables
    python benchmarks/sweep_columns.py --frames 6 runs/cube106_sweeps/history # from six true frames besides
    python benchmarks/sweep_columns.py                                        # write the tables again

A sweep's own report has the errors of its validation: of cubes, where cubes train. Here the best checkpoint of every
finished job runs the columns of conf/evaluation from six placements, stabilised, against all points of the MPM that
taught it, as `evaluate.py` does. A file that is in docs/sweep_columns.csv is not run again, in whichever sweep it is. A
table for each sweep goes into docs/results.md, between marks: mean ± standard deviation over the seeds of a setting.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import torch
from results import ROOT, put, settings

from gns_pl.evaluation.placements import Placements
from gns_pl.evaluation.references import Reference, reference_of
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.io import file_sha256
from gns_pl.io.tables import read_table, write_table
from gns_pl.rollout.policy import Policy
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.text import percent
from gns_pl.training.sweep_table import SEED, read_jobs, swept_names

TABLE = ROOT / "docs" / "sweep_columns.csv"
SPLITS = {"columns": "test", "validation": "validation"}
"""Name of an evaluation → what its columns are to a training that chooses by them; here nothing is chosen."""


@dataclass(frozen=True)
class Row:
    """A job on a column.

    Attributes:
        sweep: name of its folder.
        parameter: that was swept.
        value: of it.
        seed: of the training.
        sha256: of the best checkpoint.
        given: frames of MPM that runs go on from; 1 is the scene alone.
        scene: of conf/evaluation.
        split: "test" or "validation".
        failed: placements that did not reach the end; they are in no mean.
        runout: mean error of the final 99 % runout over the placements, relative.
        runout_std: standard deviation of it.
        height: mean error of the final mean height, relative.
        profile: mean area between the final profiles over the deposit's.
        speed: root mean square of the particles in the last frame, over the placements [m/s].
    """

    sweep: str
    parameter: str
    value: str
    seed: int
    sha256: str
    given: int
    scene: str
    split: str
    failed: int
    runout: float
    runout_std: float
    height: float
    profile: float
    speed: float


def measure(folder: Path, cache: Path, frames: Sequence[int]) -> None:
    """Add rows of a sweep to the table, every one as soon as it is measured; rows of other files are left out."""
    jobs, sweep = read_jobs(folder), folder.resolve().name
    [parameter] = [name for name in swept_names(jobs) if name != SEED]
    known = read()
    before = [row for row in known if row.sweep != sweep]
    rows: list[Row] = []
    references: dict[tuple[object, ...], Reference] = {}
    for job in (job for job in jobs if job.status == "finished"):
        file = job.folder / "best.ckpt"
        key = (sweep, parameter, job.parameters[parameter], int(job.parameters[SEED]), file_sha256(file))
        # Of the same file, whichever sweep it was in: one setting may stand in several.
        same = {(row.scene, row.given): row for row in known if row.sha256 == key[-1]}
        own = [Row(*key, *astuple(row)[len(key) :]) for row in same.values() if row.given in frames]
        rows += own
        for evaluation, split in SPLITS.items():
            config = settings(evaluation)
            solver = LearnedSolver(sweep, file, Policy(config["stabilise"]))
            asked = config["evaluation"]
            for scene in build_scenes(
                asked["columns"], None, only=None, domain=asked["domain"], duration=asked["duration"],
                interval=solver.interval, data=solver.data,
            ).values():  # fmt: skip
                for given in frames:
                    if any((row.scene, row.given) == (scene.name, given) for row in own):
                        continue
                    setup = (scene.name, given, solver.interval, str(solver.data))
                    if setup not in references:
                        references[setup] = reference_of(
                            scene, solver.checkpoint, cache=cache, seed=asked["seed"], placements=asked["placements"],
                            given=given,
                        )  # fmt: skip
                    rows.append(Row(*key, given, scene.name, split, *judge(solver, references[setup], given)))
                    write_table(TABLE, Row, [*before, *rows], digits=5)
                    print(rows[-1], flush=True)
    write_table(TABLE, Row, [*before, *rows], digits=5)


def judge(solver: LearnedSolver, reference: Reference, given: int) -> tuple[int, float, float, float, float, float]:
    """Run a scene from all placements; return `Row`'s entries from `failed` on."""
    steps = reference.whole.trajectory.num_frames - given
    runs = [solver.run(start, given=given, num_steps=steps, monitor=False) for start in reference.starts]
    placed = Placements.of(runs, reference.whole)
    mean, std = placed.over(np.mean), placed.over(np.std)
    names = ("runout_99_error", "mean_height_error", "profile_l1", "kinetic_energy")
    runout, height, profile, energy = (mean.get(name, math.nan) for name in names)
    failed = sum(math.isnan(value) for value in placed.values["runout_99_error"])
    spread = std.get("runout_99_error", math.nan)
    return failed, runout, spread, height, profile, math.sqrt(2 * energy / float(runs[0].mass.sum()))


def read() -> list[Row]:
    """Read the table; nothing if it is not there."""
    return read_table(TABLE, Row, "is no table of sweeps on columns") if TABLE.is_file() else []


def table(rows: Sequence[Row]) -> str:
    """Return the table of one sweep in Markdown."""
    scenes = sorted({row.scene for row in rows})
    titles = [scene.removeprefix("column_") for scene in scenes]
    several = len({row.given for row in rows}) > 1
    head = [rows[0].parameter, *(["runs go on from"] if several else []), "seeds"]
    for entry in ("runout", "mean height"):
        head += [f"{entry}: a = {titles[0]}", *titles[1:], "root mean square"]
    lines = [[*head, "speed at the end"], ["---"] * (len(head) + 1)]
    for value, given in dict.fromkeys((row.value, row.given) for row in rows):
        some = [row for row in rows if (row.value, row.given) == (value, given)]
        seeds = {row.seed for row in some}
        line = [value, *(["the scene" if given == 1 else f"{given} frames of MPM"] if several else []), str(len(seeds))]
        for entry in ("runout", "height"):
            line += [over_seeds([row for row in some if row.scene == each], entry) for each in scenes]
            line.append(over_seeds(some, entry, root_mean_square).removeprefix("+"))
        speed = statistics.fmean(root_mean_square([row.speed for row in some if row.seed == seed]) for seed in seeds)
        lines.append([*line, f"{1000 * speed:.0f} mm/s"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def over_seeds(
    rows: Sequence[Row], entry: str, statistic: Callable[[Sequence[float]], float] = statistics.fmean
) -> str:
    """Return mean ± standard deviation over the seeds of a statistic of an entry over the columns."""
    seeds = sorted({row.seed for row in rows})
    values = [statistic([getattr(row, entry) for row in rows if row.seed == seed]) for seed in seeds]
    return percent(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else None)


def root_mean_square(values: Sequence[float]) -> float:
    """Return it."""
    return math.sqrt(statistics.fmean(value**2 for value in values))


def tables(rows: Sequence[Row]) -> dict[str, str]:
    """Return mark in docs/results.md → the table that stands there."""
    sweeps = dict.fromkeys(row.sweep for row in rows)
    return {f"{sweep} columns": table([row for row in rows if row.sweep == sweep]) for sweep in sweeps}


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweeps", type=Path, nargs="*", help="folders of sweeps of one parameter, over seeds")
    parser.add_argument("--cache", type=Path, default=Path("datasets/reference"))
    parser.add_argument("--frames", type=int, help="true frames from which the columns are run besides")
    args = parser.parse_args()
    torch.set_num_threads(1)
    for folder in args.sweeps:
        measure(folder, args.cache, [1, *([args.frames] if args.frames else [])])
    for name, text in tables(read()).items():
        put(ROOT / "docs" / "results.md", name, text)


if __name__ == "__main__":
    main()
