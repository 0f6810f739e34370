"""The suite from its settings: who is stressed, on what, and what is left on the disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError, tolerated
from gns_pl.evaluation.checks import check_figures, default_folder, make_folder, named_checkpoints
from gns_pl.evaluation.scenes import chosen
from gns_pl.io.atomic import write_atomically
from gns_pl.text import command

SOLVERS = ("learned", "mpm")


def stress_from_settings(settings: Mapping[str, Any], label: str = "") -> dict[str, dict[str, Any]]:
    """Run the suite as conf/evaluation/stress.yaml says.

    Args:
        settings: the config as plain values.
        label: what tells this job from the others of a sweep, a folder in that of the suite; "" for none.

    Returns:
        Name of what was stressed → numbers of its scenes, its failures, and those within its data.

    Raises:
        InputError: settings that cannot be used.
    """
    suite, solver = settings["evaluation"]["stress"], settings["solver"]
    if solver not in SOLVERS:
        raise InputError(f"solver must be one of {', '.join(SOLVERS)}, not {solver!r}.")
    wanted = settings["ckpt"]
    if solver == "learned" and not wanted:
        raise InputError(f"which checkpoint? {command('evaluate')} ckpt=FILE +evaluation=stress, or solver=mpm")
    checkpoints: dict[str, Path] = {}
    if solver == "learned":
        checkpoints = named_checkpoints(wanted if isinstance(wanted, list) else [wanted])
        out = default_folder(wanted, checkpoints).parent / "stress"
    else:
        out = Path("runs/mpm/stress")
    out = (Path(settings["out"]) if settings["out"] else out) / label
    if suite["figures"]:
        check_figures()
    logger = {**settings["logger"]}
    logged = logger.pop("enabled")
    return run_suite(
        checkpoints,
        out=out,
        cache=Path(settings["cache"]),
        logger=logger if logged else None,
        stabilise=settings["stabilise"],
        **suite,
    )


def run_suite(
    checkpoints: Mapping[str, Path],
    *,
    out: Path,
    cache: Path,
    logger: Mapping[str, Any] | None,
    stabilise: Mapping[str, Any],
    seed: int,
    axes: Sequence[str] | str | None,
    label: str | None,
    shown: Sequence[str] | None,
    figures: bool,
    device: str,
    dim: int,
    interval: float,
    sand: Mapping[str, Any],
    mpm: Mapping[str, Any],
    variants: Mapping[str, Mapping[str, Any]],
    only: Sequence[str] | str | None,
) -> dict[str, dict[str, Any]]:
    """Run the suite; what is in the folder's table already is not run again, and the report is of all that is in it.

    Rows of a name that was run before with another file or other settings are replaced.

    Args:
        checkpoints: name → path of the learned simulators; none stresses the material point method.
        out: folder of the table, the report and the figure.
        cache: folder of references, which heaps start from.
        logger: {offline, project} of W&B; None logs nothing.
        stabilise: arguments of `rollout.stabilise.stabilise`.
        seed: of the scenes and placements.
        axes: names of those to run; None runs all.
        label: added to the names of what is stressed, to tell settings of one checkpoint apart; None adds nothing.
        shown: names of those whose survival curves are drawn; None draws all in the table.
        figures: draw them.
        device: of learned simulators, "auto" or as torch names it.
        dim: D of the material point method's scenes.
        interval: between its frames [s].
        sand: specification of its sand: gravity, material, walls.
        mpm: its settings.
        variants: name → settings that differ.
        only: names of the variants to run; None runs all.

    Raises:
        InputError: settings that cannot be used.
    """
    from gns_pl.evaluation import tracking
    from gns_pl.evaluation.stress import report
    from gns_pl.evaluation.stress.runs import run_scene
    from gns_pl.evaluation.stress.suite import AXES, Sand, stress_scenes

    axes = tuple(chosen(dict.fromkeys(AXES), axes, key="evaluation.stress.axes"))
    make_folder(out)
    table = out / "stress.csv"
    rows = report.read_rows(table)
    if checkpoints:
        subjects = _learned(checkpoints, device, stabilise, seed, label or "")
    else:
        subjects = _solved(variants, only, dim, interval, sand, mpm, seed)
    for subject in subjects:
        rows = [row for row in rows if row.model != subject.name or row.identity == subject.identity]
        known = {row.scene for row in rows if row.identity == subject.identity}
        dim = subject.checkpoint.simulator.config.dim if subject.checkpoint else dim
        scenes = list(stress_scenes(Sand.of(subject.data, dim, subject.interval), seed))
        for number, stress in enumerate(scene for scene in scenes if scene.axis in axes):
            if stress.scene.name not in known:
                print(f"\r{subject.name}: {stress.scene.name} ({number + 1})\033[K", end="", flush=True)
                rows.append(run_scene(subject, stress, seed=seed, cache=cache))
                report.write_rows(table, rows)
        print(f"\r{subject.name}: done\033[K", flush=True)
    files = [table, out / "stress.md"]
    write_atomically(files[1], report.document(rows, seed).encode())
    if figures:
        with tolerated("the figures"):
            files += report.draw(rows, out, shown)
    print(report.summary_table(rows))
    print("Made:", *files, sep="\n  ")
    if logger is not None:
        for folder in tracking.log_stress(rows, files, out=out, **logger):
            print(f"  {folder}")
    return {
        name: {
            "scenes": len(own_rows),
            "failed": sum(bool(row.kind) for row in own_rows),
            "failed_inside": sum(bool(row.kind) and row.inside for row in own_rows),
        }
        for name, own_rows in report.by_model(rows).items()
    }


def _identity(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:12]


def _learned(
    checkpoints: Mapping[str, Path], device: str, stabilise: Mapping[str, Any], seed: int, label: str
) -> Iterator[Any]:
    from gns_pl.evaluation.stress.runs import Subject
    from gns_pl.io import file_sha256
    from gns_pl.models.checkpoint import load_checkpoint, move
    from gns_pl.rollout.policy import Policy

    for name, path in checkpoints.items():
        checkpoint = load_checkpoint(path)
        move(checkpoint, device, "evaluation.stress.device")
        stepper = Policy(stabilise).stepper(checkpoint)
        identity = _identity(file_sha256(path), dict(stabilise), seed)
        dt = checkpoint.simulator.config.dt
        settings = ", ".join(f"{key} {value:g}" for key, value in stabilise.items() if value) or "nothing"
        yield Subject(name + label, identity, settings, checkpoint.data, dt, checkpoint, stepper)


def _solved(
    variants: Mapping[str, Mapping[str, Any]],
    only: Sequence[str] | str | None,
    dim: int,
    interval: float,
    sand: Mapping[str, Any],
    mpm: Mapping[str, Any],
    seed: int,
) -> Iterator[Any]:
    from gns_pl.evaluation.stress.runs import Subject
    from gns_pl.mpm import settings as solver

    if dim not in (2, 3):
        raise InputError(f"evaluation.stress.dim must be 2 or 3, not {dim}.")
    walls = {face: wall for face, wall in sand["walls"].items() if dim == 3 or face[0] != "y"}
    for name, changes in chosen(variants, only, "evaluation.stress.variants", "evaluation.stress.only").items():
        settings = {**mpm, **(changes or {})}
        solver.solver_config(settings)  # refuses what no run could use
        data = {**sand, "walls": walls, "mpm": settings}
        words = ", ".join(f"{key} {value}" for key, value in (changes or {}).items()) or "as tuned"
        yield Subject(
            name, _identity(solver.solver_version(settings), data, dim, interval, seed), words, data, interval
        )
