"""`evaluate.py solver=mpm`: scenes by the material point method alone; what other cells change stands beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation.checks import default_folder, named_checkpoints
from gns_pl.evaluation.maps import check_mapped_scene
from gns_pl.evaluation.outcome import outcome_of
from gns_pl.evaluation.references import resolution_spread
from gns_pl.evaluation.run_report import CHECKED, ReportedRun, check_reporting, report_lines, write_report
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.generation import reference_trajectory
from gns_pl.metrics.summary import Measured
from gns_pl.scene import Scene
from gns_pl.scene.extent import FRAME_INTERVAL, compression_notice
from gns_pl.solvers.mpm import MPMSolver

REPORTING = ("figures", "snapshots", "animation", "film", "paraview", "maps", "reached")
"""Keys of an evaluation that say what is drawn."""


def evaluate_mpm(settings: Mapping[str, Any], label: str = "") -> dict[str, ReportedRun]:
    """Run the scenes of a config (conf/evaluate.yaml) by MPM, on other cells besides, and report them.

    Material, walls and settings are those of a checkpoint's data where one is named, else the paper's.

    Args:
        settings: the config, as plain values.
        label: what tells this job from the others of a sweep, a folder in that of the evaluation; "" for none.

    Returns:
        Name of every scene → its run.

    Raises:
        InputError: settings that cannot be used.
    """
    evaluation, ckpt, cell_size = settings["evaluation"], settings["ckpt"], settings["cell_size"]
    if evaluation["split"] is not None:
        raise InputError("evaluation.split names trajectories of a data set; solver=mpm runs columns or scenes.")
    if isinstance(ckpt, list):
        raise InputError("solver=mpm takes one ckpt, whose data's material, walls and MPM settings are used, or none.")
    check_reporting(**{key: evaluation[key] for key in CHECKED}, key="evaluation")
    interval, data = settings["choice"]["frame_interval"] or FRAME_INTERVAL, dict(settings["paper"])
    mpm, out = dict(settings["choice"]["mpm"]), Path("runs/mpm/evaluation")
    if ckpt:
        data, interval, out = _of_checkpoint(ckpt)
        mpm = dict(data["mpm"])
        cell_size = cell_size or mpm["cell_size"]
    scenes = configured_scenes(evaluation, interval, data)
    solver = MPMSolver("mpm", max(settings["choice"]["cells"]), mpm, cell_size=cell_size)
    cells = tuple(float(size) for size in evaluation["spread"])
    if any(not size > 0 for size in cells):
        raise InputError(
            f"evaluation.spread: sizes of cells over those of the run must be positive, not {list(cells)}."
        )
    out = (Path(settings["out"]) if settings["out"] else out) / label
    runs = {}
    for name, scene in scenes.items():
        runs[name] = _run(solver, scene, cells, interval, evaluation["seed"], Path(settings["cache"]))
        rows = outcome_of(runs[name].trajectory).rows()
        print(f"{name}:", *report_lines(rows), *_spread_lines(runs[name]), sep="\n", flush=True)
    files = write_report(runs, out, **{key: evaluation[key] for key in REPORTING})
    if evaluation["save_trajectories"]:
        from gns_pl.io import write_trajectory

        for name, run in runs.items():
            files.append(out / f"mpm_{name}.h5")
            write_trajectory(files[-1], run.trajectory)
    print("Made:", *files, sep="\n  ")
    return runs


def configured_scenes(evaluation: Mapping[str, Any], interval: float, data: Mapping[str, Any]) -> dict[str, Scene]:
    """Return name → scene, as conf/evaluation names them.

    Args:
        evaluation: the settings.
        interval: time between frames [s].
        data: whose gravity, material and walls the columns have.

    Raises:
        InputError: as `build_scenes`.
    """
    keys = ("only", "domain", "duration")
    settings = {key: evaluation[key] for key in keys}
    scenes = build_scenes(evaluation["columns"], evaluation["scenes"], interval=interval, data=data, **settings)
    for scene in scenes.values() if evaluation["maps"] else ():
        check_mapped_scene(scene)
    return scenes


def _of_checkpoint(ckpt: str) -> tuple[dict[str, Any], float, Path]:
    """Return the data's specification, the time step and the folder of a checkpoint."""
    from gns_pl.models.checkpoint import load_checkpoint

    checkpoints = named_checkpoints([ckpt])
    [path] = checkpoints.values()
    checkpoint = load_checkpoint(path)
    if "mpm" not in checkpoint.data:
        raise InputError(f"{path}: its data do not say by which MPM they were made; leave ckpt= out for the paper's.")
    return checkpoint.data, checkpoint.simulator.config.dt, default_folder(ckpt, checkpoints).parent / "mpm"


def _run(
    solver: MPMSolver, scene: Scene, cells: Sequence[float], interval: float, seed: int, cache: Path
) -> ReportedRun:
    """Run a scene, or find it in the cache, on cells of several sizes."""
    notice = compression_notice(scene)
    if notice is not None:
        print(f"{notice}.", flush=True)
    reduction, settings = solver.reduced(scene), solver.settings_of(scene)
    words = f"; {reduction.description}" if reduction.description else ""
    print(f"{scene.name}: MPM on cells of {settings['cell_size']:.3g} m{words} …", flush=True)
    runs = []
    for size in (1.0, *cells):
        other = {**settings, "cell_size": size * settings["cell_size"]}
        run = reference_trajectory(reduction.scene, other, frame_interval=interval, seed=seed, cache_directory=cache)
        runs.append(reduction.lift(run))
    fine, *others = runs
    return ReportedRun(fine, "MPM", resolution_spread(Measured(fine), others, fine.spacing), tuple(cells))


def _spread_lines(run: ReportedRun) -> list[str]:
    if "runout_99" not in run.spread:
        return []
    from gns_pl.scene.extent import initial_extent

    length, _ = initial_extent(run.trajectory.scene)
    sizes = " and ".join(f"{size:g}" for size in run.cells)
    text = f"runout by {run.spread['runout_99'] * length:.3g} m, mean height by {run.spread['mean_height']:.3g} m"
    return report_lines([("other cells", f"{sizes} times as large change the {text}")])
