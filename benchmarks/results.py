"""What the shipped models are worth: one table, in the README, in docs/results.md and on the models' cards.

    python benchmarks/results.py                          # measure what docs/results.csv lacks, write the tables
    python benchmarks/results.py --from-table             # write the tables again
    python benchmarks/results.py --from-table --sweeps FOLDER …   # and those of sweeps, into docs/results.md

Every model runs the test columns (a = 0.8, 2.0) and the validation columns (1.2, 3.0) from six placements, stabilised
as `simulate.py` does it. Errors are against all points of the MPM that taught it, in the placement that `evaluate.py`
takes, so its page says the same: the mean over the placements, their standard deviation, the largest in brackets. A
time is that of a whole column, neighbours and copies included: CPU seconds of one thread, the least of the six runs,
since what else a machine does only adds to them. Tables go between marks in the files, so that the words around them
stay; a card's YAML head, which the Hugging Face Hub reads, is written anew.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import torch
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from gns_pl.evaluation.placements import Placements
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.generation import reference_trajectory
from gns_pl.io import file_sha256
from gns_pl.machine import machine_name
from gns_pl.metrics.summary import Measured
from gns_pl.models.shipped import FOLDER, find_checkpoint, find_corrector
from gns_pl.rollout.policy import Policy
from gns_pl.solvers.corrected import CorrectedSolver
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.trained import TrainedSolver

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results.csv"
MODELS = (
    "cube106",
    "column-fast",
    "general-fast",
    "ground",
    "column-fast-plane",
    "friction-fast-plane",
    "corrected_plane",
    "collapse",
    "collapse_plane",
    "friction_plane",
)
BASES = ("collapse", "collapse_plane", "friction_plane")
"""What others are trained on from; not in the README."""

TAGS = ["granular-flow", "physics-simulation", "graph-neural-network", "material-point-method", "pytorch"]


@dataclass(frozen=True)
class Row:
    """A model on a column.

    Attributes:
        model: its name.
        sha256: of its file.
        scene: of conf/evaluation.
        split: "test" or "validation".
        particles: of a run.
        runout: mean error of the final 99 % runout over the placements, relative.
        runout_std: standard deviation of it.
        runout_largest: the largest of them.
        height: mean error of the final mean height, relative.
        profile: mean area between the final profiles over the deposit's.
        speed: root mean square of the particles in the last frame, over the placements [m/s].
        seconds: CPU time of a run on one thread, the least of the placements.
        machine: that ran it.
    """

    model: str
    sha256: str
    scene: str
    split: str
    particles: int
    runout: float
    runout_std: float
    runout_largest: float
    height: float
    profile: float
    speed: float
    seconds: float
    machine: str


def file_of(model: str) -> Path:
    """Return the file of a model that comes with the package."""
    corrector = find_corrector(model)
    return corrector if corrector.suffix == ".corrector" else find_checkpoint(model)


def settings(name: str) -> dict[str, object]:
    """Return what `evaluate.py evaluation=NAME` says."""
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        return OmegaConf.to_container(compose("evaluate", overrides=[f"evaluation={name}"]), resolve=True)  # type: ignore[return-value]


def measure(cache: Path, known: Sequence[Row]) -> None:
    """Write a row for every model and column; one that is known is not measured again."""
    rows: list[Row] = []
    for model in MODELS:
        trained = file_of(model)
        solver: TrainedSolver
        for split, named in (("test", "columns"), ("validation", "validation")):
            config = settings(named)
            evaluation = config["evaluation"]
            if trained.suffix == ".corrector":
                solver = CorrectedSolver(model, trained)
            else:
                solver = LearnedSolver(model, trained, Policy(config["stabilise"]))
            scenes = build_scenes(
                evaluation["columns"], None, only=None, domain=evaluation["domain"],
                duration=evaluation["duration"], interval=solver.interval, data=solver.data,
            )  # fmt: skip
            seeds = range(evaluation["seed"], evaluation["seed"] + evaluation["placements"])
            for scene in scenes.values():
                row = next(
                    (r for r in known if (r.model, r.scene, r.sha256) == (model, scene.name, file_sha256(trained))),
                    None,
                )
                if row is None:
                    whole = reference_trajectory(
                        scene, solver.data["mpm"], frame_interval=solver.interval, seed=seeds[0], cache_directory=cache
                    )
                    row = judge(model, file_sha256(trained), solver, Measured(whole), seeds, split)
                rows.append(row)
                write(RESULTS, rows)
                print(row)


def judge(model: str, sha256: str, solver: TrainedSolver, whole: Measured, seeds: Sequence[int], split: str) -> Row:
    """Run a model on a column from all placements."""
    scene, runs, seconds = whole.trajectory.scene, [], []
    solver.run(scene, interval=solver.interval, seed=seeds[0])  # what is compiled at first use is not timed
    for seed in seeds:
        began = time.process_time()
        runs.append(solver.run(scene, interval=solver.interval, seed=seed))
        seconds.append(time.process_time() - began)
    placed = Placements.of(runs, whole)
    runout, mean, std = placed.values["runout_99_error"], placed.over(np.mean), placed.over(np.std)
    return Row(
        model=model, sha256=sha256, scene=scene.name, split=split, particles=runs[0].num_particles,
        runout=mean["runout_99_error"], runout_std=std["runout_99_error"], runout_largest=max(runout, key=abs),
        height=mean["mean_height_error"], profile=mean["profile_l1"],
        speed=math.sqrt(2 * mean["kinetic_energy"] / float(runs[0].mass.sum())), seconds=min(seconds),
        machine=machine_name(),
    )  # fmt: skip


def write(path: Path, rows: Sequence[Row]) -> None:
    """Write the table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [each.name for each in fields(Row)], lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in asdict(row).items()})


def read(path: Path) -> list[Row]:
    """Read the table; nothing if it is not there."""
    if not path.is_file():
        return []
    kinds = {"str": str, "int": int, "float": float}
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Row(**{each.name: kinds[str(each.type)](line[each.name]) for each in fields(Row)})
            for line in csv.DictReader(file)
        ]


def table(rows: Sequence[Row]) -> str:
    """Return the table of all models and columns in Markdown."""
    lines = [
        "| model | column | particles | final runout, 99 % | mean height | profile | speed at the end | seconds, one thread |",  # noqa: E501
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(
            f"| `{row.model}` | {row.scene.replace('column_', 'a = ')}, {row.split} | {row.particles} "
            f"| {100 * row.runout:+.1f} ± {100 * row.runout_std:.1f} % ({100 * row.runout_largest:+.1f}) "
            f"| {100 * row.height:+.1f} % | {row.profile:.2f} | {1000 * row.speed:.0f} mm/s | {row.seconds:.2f} |"
        )
    return "\n".join(lines)


def tables(rows: Sequence[Row]) -> dict[Path, str]:
    """Return file → the table that stands in it: all of it, the test columns in the README, a model's on its card."""
    cards = {card(model): [row for row in rows if row.model == model] for model in MODELS}
    parts = {
        ROOT / "docs" / "results.md": rows,
        ROOT / "README.md": [row for row in rows if row.split == "test" and row.model not in BASES],
    }
    return {path: table(part) for path, part in (parts | cards).items()}


def card(model: str) -> Path:
    """Return the card of a model."""
    return FOLDER / f"{file_of(model).stem}.md"


def head(model: str, rows: Sequence[Row]) -> str:
    """Return the YAML that stands between two lines of --- on top of a card, for the Hugging Face Hub.

    It names no `datasets`: these are identifiers of the Hub, where ours are not.
    """
    names = {"runout": "final 99 % runout, error", "height": "final mean height, error", "profile": "profile, error"}
    results = [
        {
            "task": {"type": "graph-ml", "name": "collapse of a column of dry sand"},
            "dataset": {"type": row.scene, "name": row.scene.replace("_", ", a = "), "split": row.split},
            "metrics": [{"type": key, "name": name, "value": getattr(row, key)} for key, name in names.items()],
        }
        for row in rows
        if row.model == model
    ]
    metadata = {
        "library_name": "gns_pl",
        "license": "mit",
        "pipeline_tag": "graph-ml",
        "tags": TAGS,
        "model-index": [{"name": card(model).stem, "results": results}],
    }
    return yaml.safe_dump(metadata, sort_keys=False, allow_unicode=True, width=120)


def write_tables(rows: Sequence[Row]) -> None:
    """Put the tables where they belong, and the heads onto the cards."""
    for path, text in tables(rows).items():
        put(path, "models", text)
    for model in MODELS:
        body = re.sub(r"\A---\n.*?\n---\n", "", card(model).read_text(encoding="utf-8"), flags=re.S)
        card(model).write_text(f"---\n{head(model, rows)}---\n{body}", encoding="utf-8")


def put(path: Path, name: str, content: str) -> None:
    """Put a table between its marks in a file."""
    text = path.read_text(encoding="utf-8")
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    if begin not in text or end not in text:
        raise SystemExit(f"{path}: has no place for {name}: {begin} … {end}")
    text = re.sub(f"{begin}.*?{end}", lambda _: f"{begin}\n{content}\n{end}", text, flags=re.S)
    path.write_text(text, encoding="utf-8")


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=Path("datasets/reference"))
    parser.add_argument("--from-table", action="store_true", help="measure nothing")
    parser.add_argument("--sweeps", type=Path, nargs="*", default=[], help="folders of finished sweeps, NAME each")
    args = parser.parse_args()
    torch.set_num_threads(1)
    if not args.from_table:
        measure(args.cache, read(RESULTS))
    write_tables(read(RESULTS))  # with the digits of the table
    for folder in args.sweeps:
        for suffix in ("csv", "png"):
            shutil.copy(folder / f"sweep.{suffix}", ROOT / "docs" / f"sweep_{folder.name}.{suffix}")
        blocks = (folder / "sweep.md").read_text(encoding="utf-8").split("\n\n")
        table = next(block for block in blocks if block.startswith("|"))  # over seeds, where there are several
        figure = f"![errors over the values](sweep_{folder.name}.png)"
        put(ROOT / "docs" / "results.md", folder.name, f"{table}\n\n{figure}")


if __name__ == "__main__":
    main()
