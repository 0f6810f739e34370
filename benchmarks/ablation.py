"""What each setting of `collapse` is worth: trainings that differ in one of them, judged on the validation columns.

    python benchmarks/ablation.py                          # every row, three seeds, 3,000 steps: hours on one core
    python benchmarks/ablation.py --only base,adamw --seeds 1 --steps 500
    python benchmarks/ablation.py --only base training.noise_std=2e-4      # overrides of every row

Every row is `python train.py +experiment=collapse` with the overrides that `ROWS` names, seeds 0, 1, 2, each in its own
folder below `--out`; one that is there already is not trained again, and a broken one begins anew, so the table can be
had in pieces. Weights are the averaged ones at the end, not the best on the way. The columns of the validation split
are then rolled out from their first frame and compared with the MPM that taught the network.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from gns_pl.io import read_manifest, read_trajectory
from gns_pl.metrics.summary import rollout_errors
from gns_pl.models.checkpoint import load_simulator
from gns_pl.rollout import rollout
from gns_pl.training.summary import read_summary
from gns_pl.trajectory import Trajectory

ROWS = {
    "base": (),
    "adamw": ("training.optimisation.optimiser=adamw",),
    "input_sequence_length 4": ("model.input_sequence_length=4",),
    "start_repeats 1": ("training.start_repeats=1",),
    "strain 0.06 restore 0.2": ("training.strain_std=0.06", "training.restore=0.2"),
    "no strain no restore": ("training.strain_std=0", "training.restore=0"),
    "noise 5e-4": ("training.noise_std=5e-4",),
    "context false": ("model.context=false",),
    "moving_repeats 1": ("training.moving_repeats=1",),
    "output acceleration": ("model.output=acceleration",),
    "symmetry false": ("training.optimisation.symmetry=false",),
    "huber_delta 1": ("training.optimisation.huber_delta=1",),
    "no noise-free windows": ("training.noise_free=0",),
    "no average": ("~callbacks.average",),
    "stride 1": ("training.stride=1",),
    "unroll_steps 4": ("training.optimisation.unroll_steps=4",),
    "5 message-passing steps": ("model.num_message_passing_steps=5",),
    "latent_size 64": ("model.latent_size=64",),
}
BASE = ("training.optimisation.unroll_steps=1",)
"""Of every row but those that say otherwise: unrolling takes the time of three trainings, so that it is a row."""

ERRORS = {
    "position_error": "position error [spacings]",
    "runout_99_error": "runout",
    "mean_height_error": "mean height",
    "speed_mean": "speed at the end [m/s]",
}
TRAIN = Path(__file__).parents[1] / "train.py"
THREADS = {"OMP_NUM_THREADS": "1"}
"""So small a network gains little from a second thread; two tables side by side gain a factor of two."""


def train(folder: Path, steps: int, overrides: Sequence[str]) -> None:
    """Train in a folder unless a finished training is there."""
    summary = read_summary(folder)
    if summary is not None and summary["steps"] == summary["num_steps"] == steps:
        return
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(TRAIN), "+experiment=collapse", f"hydra.run.dir={folder}", "~logger.wandb"]
    command += [f"training.optimisation.num_steps={steps}", f"trainer.val_check_interval={steps}"]
    command += ["~callbacks.progress", "trainer.enable_progress_bar=false", *overrides]
    with (folder / "output.txt").open("a") as output:
        subprocess.run(command, check=True, stdout=output, stderr=subprocess.STDOUT, env=os.environ | THREADS)


def columns_of(root: Path) -> dict[str, Trajectory]:
    """Return the columns of the validation split, by the names of their scenes."""
    folder = next(path.parent for path in sorted(root.rglob("manifest.json")))
    trajectories = [read_trajectory(folder / name) for name in read_manifest(folder).splits["valid"]]
    return {each.scene.name: each for each in trajectories if each.scene.name.startswith("valid_")}


def judge(folder: Path, columns: dict[str, Trajectory]) -> dict[tuple[str, str], float]:
    """Return the errors of a training's averaged weights by column and measure."""
    simulator, found = load_simulator(folder / "last.ckpt"), {}
    for name, frames in columns.items():
        reference = frames.every(round(simulator.config.dt / frames.dt))
        errors = rollout_errors(rollout(simulator, reference, reference.num_frames - 1), reference)
        found |= {(name, error): errors[error] for error in ERRORS}
    return found


def cell(values: Sequence[float], error: str) -> str:
    """Return mean ± standard deviation over the seeds."""
    relative, digits = error.endswith("_error") and error != "position_error", {"speed_mean": 3, "position_error": 1}
    factor, form = (100.0, ".0f") if relative else (1.0, f".{digits.get(error)}f")
    spread = f" ± {factor * statistics.stdev(values):{form}}" if len(values) > 1 else ""
    return f"{factor * statistics.mean(values):{'+' if relative else ''}{form}}{spread}" + (" %" if relative else "")


def main() -> None:
    """Train what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help=f"rows, separated by commas: {', '.join(ROWS)}")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--out", type=Path, default=Path("runs/ablation"))
    parser.add_argument("--root", type=Path, default=Path("datasets/collapse"), help="the data set; made where missing")
    args, overrides = parser.parse_known_args()
    wanted = args.only.split(",") if args.only else list(ROWS)
    unknown = sorted(set(wanted) - set(ROWS))
    if unknown:
        parser.error(f"no row {', '.join(unknown)}; there are {', '.join(ROWS)}")
    columns: dict[str, Trajectory] = {}
    for row in wanted:
        place = args.out / row.replace(" ", "_").replace(",", "")
        folders = [(place / str(seed)).resolve() for seed in range(args.seeds)]
        for seed, folder in enumerate(folders):
            train(folder, args.steps, [f"data.root={args.root}", f"seed={seed}", *BASE, *ROWS[row], *overrides])
        if not columns:
            columns = columns_of(args.root)
            heads = [f"{name.split('_')[1]}: {word}" for name in columns for word in ERRORS.values()]
            print("| a =", *heads, "ms a step |", sep=" | ")
            print("|" + "---|" * (len(heads) + 2))
        judged = [judge(folder, columns) for folder in folders]
        cells = [cell([each[key] for each in judged], key[1]) for key in judged[0]]
        paces = [summary["step_seconds"] for folder in folders if (summary := read_summary(folder))]
        known = [1e3 * pace for pace in paces if pace is not None]  # none where a training was too short to tell
        print(f"| {row}", *cells, f"{statistics.median(known):.0f} |" if known else "– |", sep=" | ", flush=True)


if __name__ == "__main__":
    main()
