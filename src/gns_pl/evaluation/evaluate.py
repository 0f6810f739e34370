"""Evaluate a checkpoint: every scene by MPM and by the learned simulator, measured, tabled, drawn and logged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError
from gns_pl.evaluation.curves import cut, write_curves
from gns_pl.evaluation.doors import check_figures, check_space, default_folder, make_folder, named_checkpoints
from gns_pl.evaluation.judge import SceneResult, judge_scene
from gns_pl.evaluation.scenes import build_scenes, chosen

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from gns_pl.checkpoint import Checkpoint


def evaluate_config(cfg: DictConfig) -> dict[str, dict[str, Any]]:
    """Evaluate as a Hydra config says (conf/evaluate.yaml); what can be refused is refused before anything heavy.

    Returns:
        Name of every checkpoint → the content of its metrics.json.
    """
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    if "stress" in settings["evaluation"]:
        from gns_pl.evaluation.stress.judge import stress_from_settings

        return stress_from_settings(settings)
    if settings["solver"] != "learned":
        raise InputError("solver=mpm is for the stress suite: python evaluate.py solver=mpm +evaluation=stress")
    evaluation, wanted = settings["evaluation"], settings["ckpt"]
    if not wanted:
        raise InputError("which checkpoint? Name one: python evaluate.py ckpt=runs/…/last.ckpt")
    checkpoints = named_checkpoints(wanted if isinstance(wanted, list) else [wanted])
    if evaluation["figures"]:
        check_figures()
    if evaluation["film"] or evaluation["paraview"]:
        check_space(film=bool(evaluation["film"]))
    logger = settings["logger"]
    logger = logger if logger.pop("enabled") else None
    out = Path(settings["out"]) if settings["out"] else default_folder(wanted, checkpoints)
    kept = {"cache": Path(settings["cache"]), "stabilise": settings["stabilise"]}
    return evaluate_all(checkpoints, out=out, logger=logger, **kept, **evaluation)


def evaluate_all(
    checkpoints: Mapping[str, Path], *, out: Path, logger: Mapping[str, Any] | None, **settings: Any
) -> dict[str, dict[str, Any]]:
    """Judge checkpoints and write one page about all of them.

    Args:
        checkpoints: name → path.
        out: folder; what one checkpoint gives goes into it, what several give into folders of their names.
        logger: {offline, project} of W&B; None logs nothing.
        settings: as of `evaluate`.

    Returns:
        Name → the content of metrics.json.

    Raises:
        InputError: as `evaluate`.
    """
    from gns_pl.evaluation import page, tracking

    folders = {name: out / name if len(checkpoints) > 1 else out for name in checkpoints}
    documents: dict[str, dict[str, Any]] = {}
    files: dict[str, list[Path]] = {}
    for name, path in checkpoints.items():
        if len(checkpoints) > 1:
            print(f"\n{name}: {path}")
        documents[name], files[name] = evaluate(path, out=folders[name], **settings)
    path = page.write_page(out / "report.html", documents, folders)
    print("Made:", *(file for each in files.values() for file in each), path, sep="\n  ")
    for name, document in documents.items():
        if logger is not None:
            print(f"  {tracking.log_evaluation(document, [*files[name], path], out=folders[name], **logger)}")
        logs = sorted(checkpoints[name].parent.glob("csv/*/metrics.csv"))
        if logs:
            print("The training's own log:", *logs, sep="\n  ")
    return documents


def evaluate(
    checkpoint_path: Path,
    *,
    out: Path,
    cache: Path,
    stabilise: Mapping[str, Any],
    columns: Mapping[str, Any],
    scenes: Sequence[str] | str | None,
    split: str | None,
    only: Sequence[str] | str | None,
    domain: Sequence[float],
    duration: float,
    spread: Sequence[float],
    seed: int,
    placements: int,
    device: str,
    figures: bool,
    snapshots: Sequence[float],
    animation: Mapping[str, int],
    film: str | None,
    paraview: bool,
    save_trajectories: bool,
) -> tuple[dict[str, Any], list[Path]]:
    """Judge a checkpoint on scenes and write everything into one folder.

    Args:
        checkpoint_path: the checkpoint.
        out: folder for what is made; created.
        cache: folder in which MPM references are kept between evaluations.
        stabilise: arguments of `rollout.stabilise.stabilise`, by which the rollouts are kept within what sand can do.
        columns: name → {length, height} [m].
        scenes: scene files to run in the columns' place; None for the columns.
        split: of the checkpoint's data set, to judge in their place: "valid", "test", "train"; None for none.
        only: names of the scenes to run; None runs all.
        domain: box of the columns [m].
        duration: simulated time of the columns [τc].
        spread: cells of further MPM runs over those of the data, by which the reference's own error is told.
        seed: of the particles' placement.
        placements: number of runs from other placements, for a band on the runout.
        device: "auto", or a device as torch names it.
        figures: draw, or leave out figures and animations.
        snapshots: times of the evolution figure [τc]; the last frame comes besides.
        animation: `num_frames` and `width` [pixels].
        film: "mp4" or "gif" for a film and a still of every scene in three dimensions; None for neither.
        paraview: write a series for ParaView of rollouts and references.
        save_trajectories: write rollouts and references as HDF5.

    Returns:
        The content of metrics.json, and the files made.

    Raises:
        InputError: a checkpoint, a scene or a folder that cannot be used.
    """
    from gns_pl.checkpoint import load_checkpoint, move
    from gns_pl.evaluation import report
    from gns_pl.evaluation.references import reference_of, stored_references
    from gns_pl.frame_simulator import cold_start

    if film not in (None, "mp4", "gif"):
        raise InputError(f"evaluation.film must be mp4, gif or null, not {film!r}.")
    checkpoint = load_checkpoint(checkpoint_path)
    config = checkpoint.simulator.config
    if cold := cold_start(config, checkpoint.provenance):
        print(cold)
    if split is None and "mpm" not in checkpoint.data:
        split = imported_split(checkpoint, checkpoint_path, wants_scenes=bool(scenes))
    stored = {} if split is None else chosen(stored_references(checkpoint, split), only, "evaluation.split")
    built = {name: each.trajectory.scene for name, each in stored.items()}
    if split is None:
        interval, data = config.dt, checkpoint.data
        built = build_scenes(columns, scenes, only=only, domain=domain, duration=duration, interval=interval, data=data)
    for name, scene in built.items():
        if scene.dim != config.dim:
            raise InputError(
                f"scene {name!r} has {scene.dim} dimensions, the simulator of {checkpoint_path} {config.dim}."
            )
        if scene.obstacles:  # said here, before minutes of MPM
            raise InputError(f"scene {name!r} has obstacles, and a learned simulator knows no obstacles yet.")
    make_folder(out)
    move(checkpoint, device, "evaluation.device")
    results, files = {}, []
    for name, scene in built.items():
        source = "MPM (computed once, then cached)" if split is None else "the stored trajectory"
        print(f"{name}: {source} and the learned rollout …", flush=True)
        reference = stored.get(name) or reference_of(scene, checkpoint, cache=cache, seed=seed, cells=spread)
        result = judge_scene(name, reference, checkpoint, stabilise=stabilise, placements=placements, seed=seed)
        results[name] = result
        files.append(out / f"curves_{name}.csv")
        write_curves(files[-1], result.curves)
        if save_trajectories:
            files += _write_trajectories(name, result, out)
        if paraview:
            files += _write_paraview(name, result, out)
    document = report.document(checkpoint, {name: result.report for name, result in results.items()})
    files = [*report.write(document, out), *files]
    if figures:
        from gns_pl.evaluation.figures import draw

        files += draw(results, out, snapshots=snapshots, **animation)
    if film is not None:
        from gns_pl.evaluation.figures import draw_in_space

        files += draw_in_space(results, out, film=film, **animation)
    report.show(document)
    return document, files


def imported_split(checkpoint: Checkpoint, path: Path, *, wants_scenes: bool) -> str:
    """Return the split that speaks for imported data, which no solver of ours made: "test", or "valid" without tests.

    Args:
        checkpoint: what is evaluated.
        path: of it, for messages.
        wants_scenes: scenes were named.

    Raises:
        InputError: scenes, or data that are not there.
    """
    from gns_pl.io import read_manifest

    if wants_scenes or "root" not in checkpoint.data:
        raise InputError(
            f"{path}: its data do not say by which MPM they were made, so nothing can be computed to compare with; "
            "name trajectories of its data: evaluation.split=test"
        )
    splits = read_manifest(checkpoint.data["root"]).splits
    split = "test" if splits["test"] else "valid"
    print(f"Its data are imported, so it is judged on their {split} trajectories (evaluation.split={split}).")
    return split


def _write_trajectories(name: str, result: SceneResult, out: Path) -> list[Path]:
    from gns_pl.io import write_trajectory

    paths = []
    for key, trajectory in result.trajectories.items():
        paths.append(out / f"{key}_{name}.h5")
        write_trajectory(paths[-1], trajectory)
    return paths


def _write_paraview(name: str, result: SceneResult, out: Path) -> list[Path]:
    from gns_pl.viz import write_paraview

    truth = result.trajectories["reference"]
    paths = []
    for key, trajectory in result.trajectories.items():
        reference = cut(truth, trajectory.num_frames) if key != "reference" else None
        folder = out / "paraview"
        folder.mkdir(exist_ok=True)
        paths.append(write_paraview(folder, trajectory, name=f"{key}_{name}", reference=reference))
    return paths
