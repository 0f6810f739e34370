"""How far final deposits are from all points of fine runs that no training saw, one scene after the other.

    python generate.py data=column_runs && python generate.py data=general_runs      # 35 minutes on two cores
    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python benchmarks/whole_runs.py --data datasets/column_runs/every_3 \
        datasets/general_runs/every_3 --solvers collapse column-fast general-fast mpm-retuned-5 mpm_7.64
    python benchmarks/whole_runs.py --from-table        # the summary of docs/whole_runs.csv again

Every solver runs the scenes of a split of these sets, filled as users fill them. Rows that are in the table with the
same solver, scene and placement are not measured again.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections import defaultdict
from pathlib import Path

import numpy as np

from gns_pl import load_solver
from gns_pl.errors import InputError
from gns_pl.io import read_manifest
from gns_pl.io.atomic import write_atomically
from gns_pl.training.deposits import deposit_errors
from gns_pl.training.validation import DEPOSIT
from gns_pl.training.whole_runs import FineRun, read_fine_run

TABLE = Path(__file__).parents[1] / "docs" / "whole_runs.csv"
KEY = ("solver", "identity", "data", "scene", "placement")


def main() -> None:
    """Measure what is missing, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="*", type=Path, default=[], help="folders of data sets with observables")
    parser.add_argument("--solvers", nargs="*", default=[], help="names or files")
    parser.add_argument("--split", default="test", choices=["train", "valid", "test"])
    parser.add_argument("--placements", type=int, default=6)
    parser.add_argument("--table", type=Path, default=TABLE)
    parser.add_argument("--from-table", action="store_true", help="measure nothing")
    arguments = parser.parse_args()
    rows = list(csv.DictReader(arguments.table.open())) if arguments.table.is_file() else []
    known = {tuple(row[name] for name in KEY) for row in rows}
    for folder in () if arguments.from_table else arguments.data:
        for name in read_manifest(folder).splits[arguments.split]:
            run = read_fine_run(folder / name, 1)
            for solver in arguments.solvers:
                rows += measure(solver, folder, run, arguments.placements, known)
        if rows:
            text = "\n".join([",".join(rows[0]), *(",".join(row.values()) for row in rows), ""])
            write_atomically(arguments.table, text.encode())
    summarise(rows)


def measure(
    name: str, folder: Path, run: FineRun, placements: int, known: set[tuple[str, ...]]
) -> list[dict[str, str]]:
    """Return the rows of a scene that are missing."""
    solver, scene, rows = load_solver(name, device="cpu"), run.start.scene, list[dict[str, str]]()
    data = folder.parent.name if folder.name.startswith("every_") else folder.name
    for placement in range(placements):
        key = (name, solver.identity()[:16], data, scene.name, str(placement))
        if key in known:
            continue
        try:
            errors = deposit_errors(solver.run(scene, seed=placement), run.fine)
        except InputError as error:
            print(f"{name} on {scene.name}: {error}", flush=True)
            errors = dict.fromkeys(DEPOSIT, math.inf)
        rows.append(dict(zip(KEY, key, strict=True)) | {name: f"{errors[name]:.5g}" for name in DEPOSIT})
    return rows


def summarise(rows: list[dict[str, str]]) -> None:
    """Print root mean squares over scenes and placements, and the mean of every scene."""
    scenes = defaultdict[tuple[str, ...], list[list[float]]](list)
    for row in rows:
        scenes[row["data"], row["solver"], row["identity"], row["scene"]].append([float(row[name]) for name in DEPOSIT])
    solvers = defaultdict[tuple[str, ...], list[list[float]]](list)
    for (data, solver, identity, scene), errors in sorted(scenes.items()):
        solvers[data, solver, identity] += errors
        front, volumes, height = np.mean(errors, axis=0)
        print(f"{data:14} {solver:18} {scene:20} front {front:+.1%}  map {volumes:.1%}  height {height:+.1%}")
    for (data, solver, _), errors in sorted(solvers.items()):
        front, volumes, height = np.sqrt(np.mean(np.square(errors), axis=0))
        print(f"{data:14} {solver:18} root mean square  front {front:.1%}  map {volumes:.1%}  height {height:.1%}")


if __name__ == "__main__":
    main()
