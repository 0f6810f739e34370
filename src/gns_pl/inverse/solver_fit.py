"""The fit of a coarse solver to fine MPM: references, search, errors before and after, and the solver's file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.generation import reference_trajectory
from gns_pl.inverse.fit import Floats
from gns_pl.inverse.fit_errors import KINDS, Row, summary, table
from gns_pl.inverse.observed import Observed, observe
from gns_pl.inverse.scenes import short_scene
from gns_pl.inverse.search import Goal, Runs, search
from gns_pl.io.lock import locked
from gns_pl.io.tables import write_table
from gns_pl.mpm.settings import solver_config, solver_version
from gns_pl.scene import Scene, read_scene
from gns_pl.solvers.fitted import Factors, FittedSolver
from gns_pl.solvers.fitted_files import kind_of_solver, read_fitted, write_fitted
from gns_pl.solvers.fitted_range import range_of
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.solvers.retuned import RetunedMPMSolver
from gns_pl.solvers.shallow import FittedShallowSolver
from gns_pl.solvers.solver import hashed
from gns_pl.text import command, did_you_mean

if TYPE_CHECKING:
    from omegaconf import DictConfig

PLACEMENTS = 3
"""Of the particles, over which the errors on held-out scenes are averaged."""


def fit_solver(
    make_goal: Callable[[Sequence[Scene]], Goal],
    scenes: Sequence[Scene],
    held_out: Sequence[Scene] = (),
    *,
    out: Path,
    name: str,
    fitted: Mapping[str, Any],
    **how: Any,
) -> Path:
    """Fit, judge, and write a solver's file OUT/NAME.yaml and its errors OUT/NAME.csv.

    Args:
        make_goal: returns what is sought on scenes, their fine runs included.
        scenes: to fit to.
        held_out: on which it is judged besides.
        out: folder; made.
        name: of the solver.
        fitted: provenance that is not known here.
        **how: bounds, difference and budget, as of `search`.

    Returns:
        The solver's file.

    Raises:
        InputError: as `search`, or a folder that holds another fit.
        StorageError: the disk refuses; the runs stay.
    """
    out.mkdir(parents=True, exist_ok=True)
    with locked(out / ".fit.lock", on_wait=lambda: print(f"{out}: another fit is writing here; waiting for it")):
        goal = make_goal(scenes)
        parts = [goal.weights.tolist(), goal.interval, goal.seed, dict(fitted)]
        runs = Runs(out / "runs.json", hashed([goal.solver.identity(), [scene.to_dict() for scene in scenes], *parts]))
        plain, factors = type(goal.solver.factors)(), search(goal, runs=runs, **how)
        if tuple(vars(plain).values()) not in runs.errors:  # the search began elsewhere
            runs.add(tuple(vars(plain).values()), goal.errors(plain))
        rows = _rows(scenes, False, *(runs.errors[tuple(vars(each).values())] for each in (plain, factors)))
        if held_out:
            judged = make_goal(held_out)
            rows += _rows(held_out, True, *(_mean_errors(judged, each) for each in (plain, factors)))
        write_table(out / f"{name}.csv", Row, rows, digits=4)
        how_fitted = {
            **fitted,
            "start": dict(vars(goal.solver.factors)),
            "runs": len(runs.errors),
            "scenes": [scene.name for scene in scenes],
            "errors": {kind: summary([row for row in rows if row.held_out == held]) for kind, held in KINDS.items()},
        }
        path = out / f"{name}.yaml"
        write_fitted(path, replace(goal.solver, factors=factors, fitted_range=range_of(scenes)), how_fitted)
    print(f"\n{table(rows)}\n\n{path}: {', '.join(f'{key} {value:.3g}' for key, value in vars(factors).items())}")
    print(f"To run it: {command('simulate')} solver={path} scene=mine.yaml")
    return path


def _mean_errors(goal: Goal, factors: Factors) -> Floats:
    """Return the errors of every scene, the mean over placements that no fit has seen [S, 3]."""
    return np.asarray(np.mean([goal.errors(factors, 1000 * number) for number in range(1, PLACEMENTS + 1)], axis=0))


def _rows(scenes: Sequence[Scene], held_out: bool, before: Floats, after: Floats) -> list[Row]:
    return [
        Row(scene.name, held_out, *np.column_stack(pair).ravel().tolist())
        for scene, *pair in zip(scenes, before, after, strict=True)
    ]


def fit_config(cfg: DictConfig) -> Path:
    """Fit as a Hydra config says (conf/fit.yaml).

    Raises:
        InputError: settings that cannot be used.
    """
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    solver = _begun(settings)
    fitted, held_out = _groups(settings, solver)
    weights, mpm, fine = settings["weights"], settings["choice"]["mpm"], settings["fine"]
    if set(weights) != {"front", "height", "map"}:
        raise InputError(f"weights: needs front, height and map, not {', '.join(weights)}.")
    fine_settings = {**mpm, "cell_size": 1 / fine["cells_per_metre"]}
    solver_config(fine_settings)  # refuses what no run can have

    def make_goal(group: Sequence[Scene]) -> Goal:
        return Goal(
            solver=solver,
            scenes=group,
            references=[fine_deposit(scene, settings) for scene in group],
            weights=np.array([weights[key] for key in ("front", "height", "map")], dtype=np.float64),
            interval=fine["interval"],
            seed=settings["seed"],
        )

    return fit_solver(
        make_goal,
        fitted,
        held_out,
        out=Path(settings["out"]),
        name=settings["name"],
        fitted={"fine": {**fine, "solver_version": solver_version(fine_settings)}, "weights": weights},
        bounds=settings["bounds"][kind_of_solver(solver)],
        **{key: settings[key] for key in ("difference", "budget")},
    )


def _begun(settings: Mapping[str, Any]) -> FittedSolver:
    """Return the solver that is fitted, with the factors with which the search begins."""
    solver = _unfitted(settings)
    if settings["start"] is None:
        return solver
    start = read_fitted(settings["start"])
    if type(start) is not type(solver):
        raise InputError(
            f"start: {settings['start']} is a fit of {kind_of_solver(start)}, not of {kind_of_solver(solver)}."
        )
    return replace(solver, factors=start.factors)


def _unfitted(settings: Mapping[str, Any]) -> FittedSolver:
    """Return the solver that is fitted, with factors of 1."""
    what, name, cells = settings["solver"], settings["name"], float(settings["cells"])
    shallow: Mapping[str, Mapping[str, Any]] = settings["choice"]["shallow"]
    if what == "mpm":
        return RetunedMPMSolver(name, cells, settings["choice"]["mpm"], num_threads=1)
    if what not in shallow:
        raise InputError(
            f"solver: {what} cannot be fitted{did_you_mean(what, ['mpm', *shallow])}; take mpm or a name of "
            f"choice.shallow ({', '.join(shallow)})."
        )
    return FittedShallowSolver(name, cells, {key: value for key, value in shallow[what].items() if key != "cells"})


def _groups(settings: Mapping[str, Any], solver: FittedSolver) -> tuple[list[Scene], list[Scene]]:
    """Return the scenes to fit to and those held out, without what the solver cannot run, which is printed."""
    scenes = {scene.name: scene for scene in _scenes(settings)}
    unknown = [name for name in settings["held_out"] if name not in scenes]
    if unknown and settings["scene"] is None:
        raise InputError(f"held_out: there is no scene {unknown[0]}; there are {', '.join(scenes)}.")
    reasons = {name: solver.unsupported_reason(scene) for name, scene in scenes.items()}
    runs = {name: scene for name, scene in scenes.items() if reasons[name] is None}
    fitted = [scene for name, scene in runs.items() if name not in settings["held_out"]]
    if not fitted:
        raise InputError("held_out: no scene is left to fit to, of those that the solver can run; hold out fewer.")
    for name, reason in reasons.items():
        if reason is not None:
            print(f"{name}: left out; {reason}")
    return fitted, [scene for name, scene in runs.items() if name in settings["held_out"]]


def fine_deposit(scene: Scene, settings: Mapping[str, Any]) -> Observed:
    """Return what fine MPM leaves of a scene, from the cache if it was run before.

    Args:
        scene: to run, as its slice or half where it has one.
        settings: as conf/fit.yaml.
    """
    reduction, fine = reduce_scene(scene), settings["fine"]
    trajectory = reference_trajectory(
        reduction.scene,
        {**settings["choice"]["mpm"], "cell_size": 1 / fine["cells_per_metre"]},
        frame_interval=fine["interval"],
        seed=0,
        cache_directory=settings["cache"],
    )
    return observe(reduction.lift(trajectory))


def _scenes(settings: Mapping[str, Any]) -> list[Scene]:
    named = settings["scene"]
    if named:
        return [read_scene(Path(path)) for path in ([named] if isinstance(named, str) else named)]
    paper = settings["paper"]
    common = {key: paper[key] for key in ("material", "walls", "gravity")}
    return [
        short_scene(name, parts, duration_tau=settings["duration_tau"], **common)
        for name, parts in settings["scenes"].items()
    ]
