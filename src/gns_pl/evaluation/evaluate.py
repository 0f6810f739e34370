"""Evaluate a checkpoint: every scene by MPM and by the learned simulator, measured, tabled, drawn and logged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError, tolerated
from gns_pl.evaluation.checks import (
    check_figures,
    check_space,
    default_folder,
    imported_split,
    make_folder,
    named_checkpoints,
    with_data,
)
from gns_pl.evaluation.judge import judge_scene
from gns_pl.evaluation.maps import check_mapped_scene, check_maps
from gns_pl.evaluation.scenes import build_scenes, chosen
from gns_pl.metrics.curves import write_curves
from gns_pl.scene.refusals import check_bare
from gns_pl.text import command

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from gns_pl.evaluation.references import Reference


def evaluate_config(cfg: DictConfig, *, label: str = "") -> dict[str, dict[str, Any]]:
    """Evaluate as a Hydra config says (conf/evaluate.yaml); what can be refused is refused before anything heavy.

    Args:
        cfg: the config.
        label: what tells this job from the others of a sweep, a folder in that of the evaluation; "" for none.

    Returns:
        Name of every checkpoint → the content of its metrics.json.
    """
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    if "stress" in settings["evaluation"]:
        from gns_pl.evaluation.stress.judge import stress_from_settings

        return stress_from_settings(settings, label)
    if settings["solver"] == "mpm":
        from gns_pl.evaluation.solver_alone import evaluate_mpm

        return {name: run.trajectory.provenance for name, run in evaluate_mpm(settings, label).items()}
    if settings["solver"] != "learned":
        from gns_pl.evaluation.any_solver import evaluate_solver

        return {
            name: {row.quantity: row.mean for row in rows} for name, rows in evaluate_solver(settings, label).items()
        }
    if settings["cell_size"] is not None:
        raise InputError("cell_size= is that of solver=mpm; a checkpoint is judged against the MPM of its own data.")
    evaluation, wanted = settings["evaluation"], settings["ckpt"]
    if not wanted:
        raise InputError(f"which checkpoint? Name one: {command('evaluate')} ckpt=runs/…/last.ckpt")
    checkpoints = named_checkpoints(wanted if isinstance(wanted, list) else [wanted])
    if evaluation["figures"]:
        check_figures()
    if evaluation["film"] or evaluation["paraview"]:
        check_space(film=bool(evaluation["film"]))
    if evaluation["maps"]:
        check_maps(**{key: evaluation[key] for key in ("figures", "reached")}, key="evaluation")
    logger = settings["logger"]
    logger = logger if logger.pop("enabled") else None
    out = (Path(settings["out"]) if settings["out"] else default_folder(wanted, checkpoints)) / label
    folders = {"cache": Path(settings["cache"]), "stabilise": settings["stabilise"], "root": settings["data"]["root"]}
    return evaluate_all(checkpoints, out=out, logger=logger, **folders, **evaluation)


def evaluate_all(
    checkpoints: Mapping[str, Path],
    *,
    out: Path,
    logger: Mapping[str, Any] | None,
    start: str | Sequence[str],
    **settings: Any,
) -> dict[str, dict[str, Any]]:
    """Judge checkpoints and write one page about all of them.

    Args:
        checkpoints: name → path.
        out: folder; what one checkpoint gives goes into it, what several give into folders of their names.
        logger: {offline, project} of W&B; None logs nothing.
        start: as of `evaluate`, or several: each checkpoint is judged from each.
        settings: as of `evaluate`.

    Returns:
        Name → the content of metrics.json.

    Raises:
        InputError: as `evaluate`.
    """
    from gns_pl.evaluation import page, tracking
    from gns_pl.evaluation.references import STARTS

    starts = list(dict.fromkeys([start] if isinstance(start, str) else start))
    if not starts or not set(starts) <= set(STARTS):
        raise InputError(f"evaluation.start must be one of {', '.join(STARTS)}, or a list of them, not {start!r}.")
    judged = {
        f"{name}_from_{each}" if len(starts) > 1 else name: (path, each)
        for name, path in checkpoints.items()
        for each in starts
    }
    folders = {name: out / name if len(judged) > 1 else out for name in judged}
    documents: dict[str, dict[str, Any]] = {}
    files: dict[str, list[Path]] = {}
    for name, (path, each) in judged.items():
        if len(judged) > 1:
            print(f"\n{name}: {path}")
        documents[name], files[name] = evaluate(path, name=name, out=folders[name], start=each, **settings)
    path = page.write_page(out / "report.html", documents, folders)
    print("Made:", *(file for paths in files.values() for file in paths), path, sep="\n  ")
    for name, document in documents.items():
        if logger is not None:
            for folder in tracking.log_evaluation(document, [*files[name], path], out=folders[name], **logger):
                print(f"  {folder}")
        logs = sorted(judged[name][0].parent.glob("csv/*/metrics.csv"))
        if logs:
            print("The training's own log:", *logs, sep="\n  ")
    return documents


def evaluate(
    checkpoint_path: Path,
    *,
    name: str,
    out: Path,
    cache: Path,
    root: str | None,
    stabilise: Mapping[str, Any],
    columns: Mapping[str, Any],
    scenes: Sequence[str] | str | None,
    split: str | None,
    start: str,
    only: Sequence[str] | str | None,
    domain: Sequence[float],
    duration: float,
    spread: Sequence[float],
    seed: int,
    placements: int,
    speed: bool,
    device: str,
    figures: bool,
    snapshots: Sequence[float],
    animation: Mapping[str, int],
    film: str | None,
    paraview: bool,
    maps: bool,
    reached: float | None,
    save_trajectories: bool,
) -> tuple[dict[str, Any], list[Path]]:
    """Judge a checkpoint on scenes and write everything into one folder.

    Args:
        checkpoint_path: the checkpoint.
        name: by which it is called in everything that is made.
        out: folder for what is made; created.
        cache: folder in which MPM references are kept between evaluations.
        root: folder of the checkpoint's data set; None where the checkpoint says it is.
        stabilise: arguments of `rollout.stabilise.stabilise`, by which the rollouts are kept within physical limits.
        columns: name → {length, height} [m].
        scenes: scene files to run in the columns' place; None for the columns.
        split: of the checkpoint's data set, to judge in their place: "valid", "test", "train"; None for none.
        start: "scene", at rest or at its initial velocity, or "frames", as many true ones as one step needs.
        only: names of the scenes to run; None runs all.
        domain: box of the columns [m].
        duration: simulated time of the columns [τc].
        spread: cells of further MPM runs over those of the data, by which the reference's own error is told.
        seed: of the particles' placement.
        placements: number of runs from other placements, whose mean is judged.
        speed: time the learned runs and the cheapest MPM that is as accurate, in this session.
        device: "auto", or a device as torch names it.
        figures: draw, or leave out figures and animations.
        snapshots: times of the evolution figure [τc]; the last frame comes besides.
        animation: `num_frames` and `width` [pixels].
        film: "mp4" or "gif" for a film and a still of every scene in three dimensions; None for neither.
        paraview: write a series for ParaView of rollouts and references.
        maps: write rasters, outlines and map figures of both.
        reached: thickness from which on a cell of a map counts as reached [m]; None for the usual one.
        save_trajectories: write rollouts and references as HDF5.

    Returns:
        The content of metrics.json, and the files made.

    Raises:
        InputError: a checkpoint, a scene or a folder that cannot be used.
    """
    from gns_pl.evaluation import exports, report
    from gns_pl.evaluation.references import reference_of, stored_references
    from gns_pl.models.checkpoint import load_checkpoint, move
    from gns_pl.models.geoelements import cold_start
    from gns_pl.rollout.policy import Policy
    from gns_pl.solvers.learned import LearnedSolver
    from gns_pl.solvers.trained import reduction_for

    if film not in (None, "mp4", "gif"):
        raise InputError(f"evaluation.film must be mp4, gif or null, not {film!r}.")
    if placements < 0:
        raise InputError(f"evaluation.placements must be 0 or more, not {placements}.")
    checkpoint = load_checkpoint(checkpoint_path)
    if root is not None:
        checkpoint = with_data(checkpoint, root)
    config = checkpoint.simulator.config
    if start == "scene" and (notice := cold_start(config, checkpoint.provenance)):
        print(notice)
    if speed and "mpm" not in checkpoint.data:
        raise InputError("evaluation.speed: these data do not say by which MPM they were made, so none can be timed.")
    if split is None and "mpm" not in checkpoint.data:
        split = imported_split(checkpoint, checkpoint_path, wants_scenes=bool(scenes))
    given = config.input_sequence_length if start == "frames" else 1
    stored: dict[str, Reference] = {}
    if split is not None:
        # The frames of other placements are stored nowhere, so there are none with start=frames.
        number = placements if given == 1 else 0
        references = stored_references(checkpoint, split, placements=number, seed=seed)
        stored = chosen(references, only, "evaluation.split")
    built = {key: reference.trajectory.scene for key, reference in stored.items()}
    if split is None:
        interval, data = config.dt, checkpoint.data
        built = build_scenes(columns, scenes, only=only, domain=domain, duration=duration, interval=interval, data=data)
    for key, scene in built.items():
        if not config.sees_surfaces:
            check_bare(f"scene {key!r}", scene)  # said here, before minutes of MPM
        frames = stored[key].trajectory.num_frames if key in stored else round(scene.duration / config.dt) + 1
        if frames <= given:
            raise InputError(f"scene {key!r} has {frames} frames, too few to go on from {given} (evaluation.start).")
        sliced = reduction_for(scene, config.dim)
        if sliced.description:
            print(f"{key}: judged in two dimensions, {sliced.description}")
        built[key] = sliced.scene
        if maps:
            check_mapped_scene(sliced.scene)
    make_folder(out)
    move(checkpoint, device, "evaluation.device")
    print(report.describe_start(config.to_dict(), given))
    solver = LearnedSolver.of(checkpoint, name, Policy(stabilise))
    results, files = {}, []
    for key, scene in built.items():
        source = "MPM (computed once, then cached)" if split is None else "the stored trajectory"
        print(f"{key}: {source} and the learned rollouts …", flush=True)
        reference = stored.get(key) or reference_of(
            scene, checkpoint, cache=cache, seed=seed, cells=spread, placements=placements, given=given
        )
        result = judge_scene(key, reference, solver, given=given)
        results[key] = result
        if speed:
            from gns_pl.evaluation.speed import measure_speed

            placed = result.report["placements"]["runout_99_error"]
            errors = placed or [result.report["errors"]["learned"]["runout_99_error"]]
            print(f"{key}: times of the learned runs and of MPM …", flush=True)
            timed = measure_speed(reference, solver, errors, given=given, seed=seed)
            result.report["speed"] = timed
        files.append(out / f"curves_{key}.csv")
        write_curves(files[-1], result.curves)
        if save_trajectories:
            files += exports.write_trajectories(key, result, out)
        if paraview:
            files += exports.write_paraview_series(key, result, out)
        if maps:
            files += exports.write_all_maps(key, result, out, figures=figures, reached=reached)
    document = report.document(name, checkpoint, {key: result.report for key, result in results.items()})
    files = [*report.write(document, out), *files]
    if figures:
        from gns_pl.evaluation.figures import draw

        with tolerated("the figures"):
            files += draw(results, out, snapshots=snapshots, **animation)
    if film is not None:
        from gns_pl.evaluation.figures import draw_in_space

        with tolerated("the films"):
            files += draw_in_space(results, out, film=film, **animation)
    report.show(document)
    return document, files
