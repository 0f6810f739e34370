"""Evaluate a checkpoint: every scene by MPM and by the learned simulator, measured, tabled, drawn and logged."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.evaluation.curves import Curves, compute_curves, cut, num_finite_frames, write_curves
from gns_pl.evaluation.measures import characteristic_time, initial_extent, particle_spacing
from gns_pl.evaluation.metrics import ERRORS, SUMMARY, rollout_errors, summarise
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.pretrained import find_checkpoint, pretrained_names
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from gns_pl.checkpoint import Checkpoint


@dataclass(frozen=True)
class SceneResult:
    """What one scene gave.

    Attributes:
        trajectories: "reference" (MPM) and "learned", the latter with its finite frames only.
        curves: the same keys → `compute_curves`.
        failed_at: time of the rollout's first frame that is not finite [s]; None if there is none.
        report: this scene's part of metrics.json.
    """

    trajectories: dict[str, Trajectory]
    curves: dict[str, Curves]
    failed_at: float | None
    report: dict[str, Any]


def evaluate_config(cfg: DictConfig) -> dict[str, Any]:
    """Evaluate as a Hydra config says (conf/evaluate.yaml); what can be refused is refused before anything heavy."""
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    evaluation = settings["evaluation"]
    if not settings["ckpt"]:
        raise InputError("which checkpoint? Name one: python evaluate.py ckpt=runs/…/last.ckpt")
    checkpoint = find_checkpoint(settings["ckpt"])
    if not checkpoint.is_file():
        known = ", ".join(pretrained_names())
        raise InputError(f"{checkpoint}: there is no such checkpoint; those that come with gns_pl are {known}.")
    if evaluation["figures"]:
        check_figures()
    logger = settings["logger"]
    logger = logger if logger.pop("enabled") else None
    named = checkpoint != Path(settings["ckpt"])  # one of the package's, in whose folder nothing is written
    beside = Path("runs") / checkpoint.stem if named else checkpoint.parent
    out = Path(settings["out"]) if settings["out"] else beside / "evaluation"
    return evaluate(checkpoint, out=out, cache=Path(settings["cache"]), logger=logger, **evaluation)


def check_figures() -> None:
    """Raise an `InputError` if the packages that draw are missing."""
    from gns_pl.viz import missing_packages

    missing = missing_packages()
    if missing:
        raise InputError(
            f"figures need {' and '.join(missing)}: pip install 'gns_pl[viz]', or go without: evaluation.figures=false"
        )


def evaluate(
    checkpoint_path: Path,
    *,
    out: Path,
    cache: Path,
    scenes: Mapping[str, Any],
    only: Sequence[str] | str | None,
    domain: Sequence[float],
    duration: float,
    seed: int,
    device: str,
    figures: bool,
    snapshots: Sequence[float],
    animation: Mapping[str, int],
    save_trajectories: bool,
    logger: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Judge a checkpoint on scenes and write everything into one folder.

    Args:
        checkpoint_path: the checkpoint.
        out: folder for what is made; created.
        cache: folder in which MPM references are kept between evaluations.
        scenes: name → {length, height} [m] or path of a scene file.
        only: names of the scenes to run; None runs all.
        domain: box of the columns [m].
        duration: simulated time of the columns [τc].
        seed: of the particles' placement.
        device: "auto", or a device as torch names it.
        figures: draw, or leave out figures and animations.
        snapshots: times of the evolution figure [τc]; the last frame comes besides.
        animation: `num_frames` and `width` [pixels].
        save_trajectories: write rollouts and references as HDF5.
        logger: {offline, project} of W&B; None logs nothing.

    Returns:
        The content of metrics.json.

    Raises:
        InputError: a checkpoint, a scene or a folder that cannot be used.
    """
    from gns_pl.checkpoint import load_checkpoint, move
    from gns_pl.evaluation import report, tracking

    checkpoint = load_checkpoint(checkpoint_path)
    if "mpm" not in checkpoint.data:
        raise InputError(
            f"{checkpoint_path}: its data do not say by which MPM they were made, so nothing can be compared."
        )
    interval = checkpoint.simulator.config.dt
    built = build_scenes(scenes, only=only, domain=domain, duration=duration, interval=interval, data=checkpoint.data)
    for name, scene in built.items():
        if scene.dim != checkpoint.simulator.config.dim:
            raise InputError(
                f"scene {name!r} has {scene.dim} dimensions, the simulator of {checkpoint_path} "
                f"{checkpoint.simulator.config.dim}."
            )
        if scene.obstacles:  # said here, before minutes of MPM
            raise InputError(f"scene {name!r} has obstacles, and a learned simulator knows no obstacles yet.")
    _make_folder(out)
    move(checkpoint, device, "evaluation.device")
    results, files = {}, []
    for name, scene in built.items():
        print(f"{name}: MPM (computed once, then cached) and the learned rollout …", flush=True)
        results[name] = result = judge_scene(name, scene, checkpoint, cache=cache, seed=seed)
        files.append(out / f"curves_{name}.csv")
        write_curves(files[-1], result.curves)
        if save_trajectories:
            files += _write_trajectories(name, result, out)
    document = report.document(checkpoint, {name: result.report for name, result in results.items()})
    files = [*report.write(document, out), *files]
    if figures:
        from gns_pl.evaluation.figures import draw

        files += draw(results, out, snapshots=snapshots, **animation)
    report.show(document, files)
    if logger is not None:
        print(f"  {tracking.log_evaluation(document, files, out=out, **logger)}")
    logs = sorted(checkpoint_path.parent.glob("csv/*/metrics.csv"))
    if logs:
        print("The training's own log:", *logs, sep="\n  ")
    return document


def judge_scene(name: str, scene: Scene, checkpoint: Checkpoint, *, cache: Path, seed: int) -> SceneResult:
    """Run one scene by MPM (from the cache if it is there) and by the learned simulator, and measure both.

    A simulator that was trained on every k-th point of fine simulations is judged on every k-th point of a fine one.
    The rollout starts from the reference's first frame, so both have the same particles, one to one. A rollout that
    ends before the reference or stops being finite is reported as failed; nothing is raised.

    Args:
        name: of the scene, for messages.
        scene: what to run.
        checkpoint: simulator and the specification of its data, whose MPM settings the reference takes.
        cache: folder of references.
        seed: of the particles' placement.
    """
    from gns_pl.generation import chosen_every, reference_trajectory, thin_trajectory
    from gns_pl.rollout import rollout
    from gns_pl.rollout.progress import counting

    interval, mpm = checkpoint.simulator.config.dt, checkpoint.data["mpm"]
    reference = reference_trajectory(scene, mpm=mpm, frame_interval=interval, seed=seed, cache_directory=cache)
    every = chosen_every(checkpoint.data)
    middle = [(every - 1) // 2] * scene.dim  # of the lattices to choose from, the one that stands least to one side
    reference = thin_trajectory(reference, mpm, seed, every, middle)
    with counting(f"{name}: learned rollout", interval) as on_step:
        learned = rollout(checkpoint.simulator, cut(reference, 1), reference.num_frames - 1, on_step=on_step)
    finite = num_finite_frames(learned)
    failed_at = finite * learned.dt if finite < reference.num_frames else None
    trajectories = {"reference": reference, "learned": cut(learned, finite)}
    curves = {key: compute_curves(trajectory) for key, trajectory in trajectories.items()}
    still = rollout_errors(_motionless(reference), reference)
    errors = rollout_errors(learned, reference)
    length, height = initial_extent(scene)
    report: dict[str, Any] = {
        "scene": scene.to_dict(),
        "length": length,
        "height": height,
        "aspect_ratio": height / length,
        "characteristic_time": characteristic_time(scene),
        "spacing": particle_spacing(reference),
        "num_particles": reference.num_particles,
        "num_steps": reference.num_frames - 1,
        "dt": reference.dt,
        "failed_at": failed_at,
        "reference": summarise(reference, curves["reference"]),
        "learned": {quantity.name: errors[quantity.name] for quantity in SUMMARY},
        "no_motion": {quantity.name: still[quantity.name] for quantity in SUMMARY},
        "errors": {
            "learned": {quantity.name: errors[quantity.name] for quantity in ERRORS},
            "no_motion": {quantity.name: still[quantity.name] for quantity in ERRORS},
        },
        "wall_seconds": {
            "reference": reference.provenance.get("wall_seconds"),
            "learned": learned.provenance.get("wall_seconds"),
        },
        "made_by": {"reference": reference.provenance, "learned": learned.provenance},
    }
    return SceneResult(trajectories, curves, failed_at, report)


def _motionless(reference: Trajectory) -> Trajectory:
    """Return the trivial baseline: nothing moves."""
    return replace(
        reference,
        position=np.repeat(reference.position[:1], reference.num_frames, axis=0),
        initial_velocity=np.zeros_like(reference.initial_velocity),
    )


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be created ({error.strerror}); choose another folder with out=…") from error
    if not os.access(out, os.W_OK):
        raise InputError(f"{out}: cannot be written; choose another folder with out=…")


def _write_trajectories(name: str, result: SceneResult, out: Path) -> list[Path]:
    from gns_pl.io import write_trajectory

    paths = []
    for key, trajectory in result.trajectories.items():
        paths.append(out / f"{key}_{name}.h5")
        write_trajectory(paths[-1], trajectory)
    return paths
