"""What each part of training on whole runs is worth: trainings in plane strain that differ in one of them.

    python benchmarks/whole_run_ablation.py                  # every row, three seeds, 120 steps: three hours of a core
    python benchmarks/whole_run_ablation.py --only "base,kept points" --seeds 1 --steps 20
    python benchmarks/whole_run_ablation.py --from-table     # the table of docs/whole_run_ablation.csv again

Every row is `python train.py +experiment=column-fast-plane` with what `ROWS` names, each in a folder of its own below
`--out`: a finished one is not trained again, a broken one goes on. Rows `lattice …` have the same fine runs, but every
third lattice point of them in place of a point drawn in each block; these are made once, below `--out`. What is
reported are the deposits of the scenes that validate, three placements each, against all points of the fine runs: root
mean squares, of the weights that a training would keep.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import statistics
import subprocess
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py

from gns_pl.io import read_manifest, read_observables, read_trajectory
from gns_pl.io.atomic import write_atomically
from gns_pl.io.observables import write_observables
from gns_pl.io.schema import OBSERVABLES
from gns_pl.metrics.observables import compute_observables
from gns_pl.training.summary import read_summary

ROWS = {
    "base": (),
    "kept points": (),  # compared with what the kept points do: `of_kept_points`
    "windows 0.1": ("training.rollout.weights.windows=0.1",),
    "rise 1": ("training.rollout.weights.rise=1",),
    "no rise": ("training.rollout.weights.rise=0",),
    "map alone": ("training.rollout.weights.front=0", "training.rollout.weights.height=0"),
    "front alone": ("training.rollout.weights.map=0", "training.rollout.weights.height=0"),
    "whole at the end": ("training.rollout.whole_from=1",),
    "9 scenes": ("training.num_train=9",),
    "no symmetry": ("training.optimisation.symmetry=false",),
    "single steps": (  # from random weights, as `collapse_plane` begins, but shorter; no whole run
        "ckpt=null",
        *(f"training.optimisation.{key}" for key in ("optimiser=muon", "learning_rate=2e-3", "warmup_steps=200")),
        "callbacks.average.decay=0.999",
    ),
}
KEPT, SINGLE, LATTICE = "kept points", "single steps", "lattice "
ROWS |= {f"{LATTICE}{name}": ("data.sampling=lattice", *ROWS[name]) for name in (SINGLE, "windows 0.1", KEPT)}
SINGLE_FOR_WHOLE = 30
"""So many steps are made in place of one of whole runs where none is: they take about as long."""
ERRORS = ("deposit_error", "front_rms", "map_rms", "height_rms")
ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "whole_run_ablation.csv"


def of_kept_points(source: Path, target: Path) -> Path:
    """Copy a data set so that the runs it trains on are observed by the points kept of them; validation as it is."""
    if not target.is_dir():
        building = target.with_name(f"{target.name}.building")
        shutil.rmtree(building, ignore_errors=True)
        shutil.copytree(source, building)
        for name in read_manifest(building).splits["train"]:
            trajectory, whole = read_trajectory(building / name), read_observables(building / name)
            assert whole is not None
            kept = compute_observables(trajectory, whole.cell)
            with h5py.File(building / name, "r+") as file:
                del file[OBSERVABLES]
                write_observables(file, replace(kept, percents=whole.percents))
        building.rename(target)
    return target


def of_lattices(target: Path) -> Path:
    """Make the fine runs of `column_plane_runs` again, and keep every third lattice point, unless they are there."""
    settings = ["data=column_plane_runs", "data.sampling=lattice", f"data.root={target}"]
    subprocess.run([sys.executable, str(ROOT / "generate.py"), *settings], check=True)
    return target


def train(folder: Path, steps: int, whole_runs: int, root: Path, overrides: Sequence[str]) -> dict[str, float]:
    """Train in a folder unless a finished training is there; return the errors of its best validation.

    Args:
        folder: of the training.
        steps: in all.
        whole_runs: of these, the last ones, which are of whole runs.
        root: folder of the data set.
        overrides: of the experiment.
    """
    summary = read_summary(folder)
    if summary is None or summary["steps"] != steps:
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, str(ROOT / "train.py"), "+experiment=column-fast-plane", f"hydra.run.dir={folder}"]
        command += [f"training.optimisation.num_steps={steps}", f"training.rollout.num_steps={whole_runs}"]
        command += [f"data.root={root}", "logger=csv", "~callbacks.progress", "trainer.enable_progress_bar=false"]
        with (folder / "output.txt").open("a") as output:
            subprocess.run(
                [*command, *overrides],
                check=True,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
            )
        summary = read_summary(folder)
    assert summary is not None
    return {error: float(summary["best"][error]) for error in ERRORS} | {"step": float(summary["best"]["step"])}


def table(rows: Sequence[dict[str, str]]) -> str:
    """Return the table: mean ± standard deviation over the seeds."""
    found = defaultdict[str, list[dict[str, str]]](list)
    for row in rows:
        found[row["row"]].append(row)
    lines = ["| | seeds | worse of front and map | front | map | height |", "|---|---|---|---|---|---|"]
    for name in (name for name in ROWS if name in found):
        cells = [cell([100 * float(row[error]) for row in found[name]]) for error in ERRORS]
        lines.append(f"| {name} | {len(found[name])} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def cell(values: Sequence[float]) -> str:
    """Return mean ± standard deviation, in per cent."""
    spread = f" ± {statistics.stdev(values):.1f}" if len(values) > 1 else ""
    return f"{statistics.mean(values):.1f}{spread} %"


def main() -> None:
    """Train what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"rows, separated by commas: {', '.join(ROWS)}")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--out", type=Path, default=Path("runs/whole_run_ablation"))
    parser.add_argument("--data", type=Path, default=Path("datasets/column_plane_runs"), help="made by generate.py")
    parser.add_argument("--table", type=Path, default=TABLE)
    parser.add_argument("--from-table", action="store_true", help="train nothing")
    args = parser.parse_args()
    wanted = args.only.split(",") if args.only else list(ROWS)
    unknown = sorted(set(wanted) - set(ROWS))
    if unknown:
        parser.error(f"no row {', '.join(unknown)}; there are {', '.join(ROWS)}")
    rows = list(csv.DictReader(args.table.open())) if args.table.is_file() else []
    for seed in range(0 if args.from_table else args.seeds):
        for name in wanted:
            whole_runs = 0 if name.endswith(SINGLE) else args.steps
            steps = whole_runs or args.steps * SINGLE_FOR_WHOLE
            key = {"row": name, "seed": str(seed), "steps": str(steps)}
            if any(key.items() <= row.items() for row in rows):
                continue
            args.out.mkdir(parents=True, exist_ok=True)
            root = of_lattices(args.out / "lattices") if name.startswith(LATTICE) else args.data
            if name.endswith(KEPT):
                target = args.out / name.replace(" ", "_")
                of_kept_points(root / "every_3", target / "every_3")
                root = target
            folder = args.out / f"{name}_{seed}".replace(" ", "_")
            errors = train(folder, steps, whole_runs, root, [f"seed={seed}", *ROWS[name]])
            rows.append(key | {error: f"{value:.5g}" for error, value in errors.items()})
            text = "\n".join([",".join(rows[0]), *(",".join(row.values()) for row in rows), ""])
            write_atomically(args.table, text.encode())
            print(f"{name}, seed {seed}: " + ", ".join(f"{error} {errors[error]:.3f}" for error in ERRORS), flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
