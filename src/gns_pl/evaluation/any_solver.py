"""`evaluate.py solver=NAME`: any solver on scenes, from several placements, against fine MPM."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.evaluation.placements import Placements
from gns_pl.evaluation.run_report import CHECKED, ReportedRun, check_reporting, write_report
from gns_pl.evaluation.solver_alone import REPORTING, configured_scenes
from gns_pl.generation import reference_trajectory
from gns_pl.io.tables import write_table
from gns_pl.metrics.quantities import COMPARISONS, SUMMARY
from gns_pl.metrics.summary import Measured
from gns_pl.rollout.policy import Policy
from gns_pl.scene import Scene
from gns_pl.scene.extent import FRAME_INTERVAL
from gns_pl.solvers.catalogue import load_solver
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.solver import Solver
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class ErrorRow:
    """One error of a solver on a scene, over placements.

    Attributes:
        scene: its name.
        quantity: name of the error, as in metrics.json.
        mean: over the placements that reached the end.
        std: standard deviation over them.
        largest: of them, by its size.
        failed: placements that did not reach the end.
    """

    scene: str
    quantity: str
    mean: float
    std: float
    largest: float
    failed: int


def evaluate_solver(settings: Mapping[str, Any], label: str = "") -> dict[str, list[ErrorRow]]:
    """Run the scenes of a config (conf/evaluate.yaml) by the solver it names, and judge it by MPM on fine cells.

    Material and walls are the paper's. The reference has cells of `cell_size`, or the finest of `choice.cells`.

    Args:
        settings: the config, as plain values.
        label: what tells this job from the others of a sweep, a folder in that of the evaluation; "" for none.

    Returns:
        Name of every scene → its errors.

    Raises:
        InputError: settings that cannot be used, or a scene that the solver cannot run.
    """
    evaluation, choice, cell_size = settings["evaluation"], settings["choice"], settings["cell_size"]
    if settings["ckpt"]:
        raise InputError(
            "solver= names what is judged, ckpt= a checkpoint that is judged against its own data; give one."
        )
    if evaluation["split"] is not None:
        raise InputError(
            "evaluation.split names trajectories of a checkpoint's data set; solver= runs columns or scenes."
        )
    if evaluation["placements"] < 1:
        raise InputError(f"evaluation.placements must be 1 or more with solver=, not {evaluation['placements']}.")
    check_reporting(**{key: evaluation[key] for key in CHECKED}, key="evaluation")
    policy = Policy(settings["stabilise"])
    solver = load_solver(settings["solver"], device=evaluation["device"], policy=policy, choice=choice)
    interval = choice["frame_interval"] or FRAME_INTERVAL
    scenes = configured_scenes(evaluation, interval, dict(settings["paper"]))
    for name, scene in scenes.items():
        if (reason := solver.unsupported_reason(scene)) is not None:
            raise InputError(f"scene {name!r}: {solver.name}: {reason}")
    fine = MPMSolver("mpm", max(choice["cells"]), choice["mpm"], cell_size=cell_size)
    seeds = range(evaluation["seed"], evaluation["seed"] + evaluation["placements"])
    runs: dict[str, ReportedRun] = {}
    rows: dict[str, list[ErrorRow]] = {}
    for name, scene in scenes.items():
        print(f"{name}: MPM on cells of {fine.settings_of(scene)['cell_size']:.3g} m, then {solver.name} …", flush=True)
        outside = solver.out_of_range_reason(scene)
        if outside is not None:
            print(f"{name}: outside the range of {solver.name}: {outside}")
        truth = _reference(fine, scene, interval, seeds[0], Path(settings["cache"]))
        trajectories = [solver.run(scene, interval=interval, seed=seed) for seed in seeds]
        rows[name] = _errors(name, Placements.of(trajectories, Measured(truth)))
        runs[name] = ReportedRun(trajectories[0], solver.name, reference=truth)
        _print(solver, rows[name], len(seeds))
    out = (Path(settings["out"]) if settings["out"] else Path("runs") / solver.name / "evaluation") / label
    files = write_report(
        {name: run for name, run in runs.items() if np.isfinite(run.trajectory.position).all()},
        out,
        **{key: evaluation[key] for key in REPORTING},
    )
    write_table(out / "errors.csv", ErrorRow, [row for some in rows.values() for row in some], digits=6)
    print("Made:", out / "errors.csv", *files, sep="\n  ")
    return rows


def _reference(fine: MPMSolver, scene: Scene, interval: float, seed: int, cache: Path) -> Trajectory:
    """Return the scene by fine MPM, from the cache where it was run before."""
    reduction, mpm = fine.reduced(scene), fine.settings_of(scene)
    run = reference_trajectory(reduction.scene, mpm, frame_interval=interval, seed=seed, cache_directory=cache)
    return reduction.lift(run)


def _errors(name: str, placements: Placements) -> list[ErrorRow]:
    wanted = [f"{metric.name}_error" for metric in SUMMARY if metric.error] + [each.name for each in COMPARISONS]
    rows = []
    for quantity in wanted:
        values = np.array(placements.values[quantity])
        finite = values[np.isfinite(values)]
        failed = int(len(values) - np.isfinite(np.array(placements.values["mean_height_error"])).sum())
        if len(finite):
            largest = float(finite[np.abs(finite).argmax()])
            rows.append(ErrorRow(name, quantity, float(finite.mean()), float(finite.std()), largest, failed))
        else:
            rows.append(ErrorRow(name, quantity, np.nan, np.nan, np.nan, failed))
    return rows


def _print(solver: Solver, rows: list[ErrorRow], number: int) -> None:
    for row in rows:
        if row.quantity in ("runout_99_error", "mean_height_error"):
            what = "runout, 99 % of the mass" if row.quantity == "runout_99_error" else "mean height"
            text = f"{100 * row.mean:+.1f} ± {100 * row.std:.1f} % (largest {100 * row.largest:+.1f} %)"
            print(f"  {solver.name}: {what} {text} over {number} placements, {row.failed} failed")
