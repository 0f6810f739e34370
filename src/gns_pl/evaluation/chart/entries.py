"""What stands on the chart: the solvers of a configuration, MPM's other settings, and the trivial ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.converged import Converged
from gns_pl.evaluation.checks import named_checkpoints
from gns_pl.models.shipped import find_checkpoint, find_corrector, is_corrector
from gns_pl.rollout.policy import Policy
from gns_pl.scene import Scene
from gns_pl.solvers.catalogue import make_solvers, solver_name
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.solver import Solver
from gns_pl.solvers.trivial import Ballistic, Still


def scene_of(solver: Solver, judged: Converged) -> Scene:
    """Return what a solver runs: the slice where one does, unless it is one that runs scenes whole."""
    return judged.scene if isinstance(solver, MPMSolver) and not solver.reduces else judged.flat


def make_entries(
    ckpt: Sequence[str],
    choice: Mapping[str, Any],
    variants: Mapping[str, Any],
    trivial: float,
    stabilise: Mapping[str, Any],
    device: str,
    solver_device: str,
) -> list[Solver]:
    """Return all solvers, MPM's first.

    Args:
        ckpt: checkpoints and correctors besides those of the choice.
        choice: the solvers of `simulate.py`, conf/choice.
        variants: more settings of MPM, as `mpm_variants`.
        trivial: cells per √(L0 H0) whose particles the trivial baselines move.
        stabilise: arguments of `rollout.stabilise.stabilise`, for learned runs.
        device: of learned simulators, "cpu" or "cuda".
        solver_device: of MPM, likewise.

    Raises:
        InputError: a checkpoint that is not there, two solvers of one name, or settings that make none.
    """
    policy = Policy(stabilise)
    there = [find_checkpoint(path) for path in choice["learned"]]
    checkpoints = [path for path in ckpt if not is_corrector(path)]
    given = [path for path in dict.fromkeys(named_checkpoints(checkpoints).values()) if path not in there]
    corrected = {find_corrector(path): path for path in [*choice["corrected"], *filter(is_corrector, ckpt)][::-1]}
    solvers = make_solvers({**choice, "corrected": list(corrected.values())[::-1]}, policy)
    solvers = [
        *(solver.on(solver_device) for solver in solvers if solver.group == "mpm"),
        *(solver.on(solver_device) for solver in mpm_variants(choice["mpm"], variants)),
        *(solver.on(device) if solver.group == "learned" else solver for solver in solvers if solver.group != "mpm"),
        *(LearnedSolver(solver_name(path), path, policy).on(device) for path in given),
        Still("nothing_moves", trivial),
        Ballistic("ballistic", trivial),
    ]
    names = [solver.name for solver in solvers]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"the chart would hold {', '.join(twice)} twice; rename a file, or leave one out.")
    return solvers


def mpm_variants(mpm: Mapping[str, Any], variants: Mapping[str, Any]) -> list[MPMSolver]:
    """Return settings of MPM beside the sizes of cells of the choice; a tolerance does not choose them.

    Args:
        mpm: the settings from which they depart.
        variants: {cells, points: {cells, per_direction}, courant: {cells, numbers}, whole: {cells}}, each a list; every
            size of cells with every number of points per direction, or Courant number, or in three dimensions.

    Raises:
        InputError: another key.
    """
    allowed = {
        "cells": None,
        "points": ("cells", "per_direction"),
        "courant": ("cells", "numbers"),
        "whole": ("cells",),
    }
    for key, value in variants.items():
        inner = allowed.get(key, ())
        if key not in allowed or (inner is not None and sorted(value) != sorted(inner)):
            raise InputError(
                "variants: takes cells, points.{cells,per_direction}, courant.{cells,numbers} and whole.cells, "
                f"not {key}={value}."
            )

    def solver(name: str, cells: float, settings: Mapping[str, Any] = mpm, reduces: bool = True) -> MPMSolver:
        return MPMSolver(name, float(cells), settings, reduces, selectable=False)

    points, courant, whole = (variants.get(key) or {"cells": ()} for key in ("points", "courant", "whole"))
    solvers = [solver(f"mpm_{cells:g}", cells) for cells in variants.get("cells", ())]
    for cells in points["cells"]:
        for number in points["per_direction"]:
            solvers.append(solver(f"mpm_{cells:g}_p{number}", cells, {**mpm, "points_per_direction": number}))
    for cells in courant["cells"]:
        for number in courant["numbers"]:
            solvers.append(solver(f"mpm_{cells:g}_c{number:g}", cells, {**mpm, "courant": number}))
    return [*solvers, *(solver(f"mpm_{cells:g}_whole", cells, reduces=False) for cells in whole["cells"])]
