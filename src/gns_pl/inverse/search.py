"""Which factors make a coarse solver leave the deposits of fine MPM: a search by runs alone.

Every run of all scenes is kept as it is made, and the search is deterministic: one that was broken off finds its runs,
and goes on after them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gns_pl.errors import InputError
from gns_pl.inverse.fit import Bounds, Floats, solve
from gns_pl.inverse.observed import Observed, errors, observe
from gns_pl.io.atomic import write_atomically
from gns_pl.machine import available_cores
from gns_pl.mpm import SimulationError
from gns_pl.scene import Scene
from gns_pl.solvers.fitted import Factors, FittedSolver

FAILED = 2.0
"""Each error of a run that became unstable."""

TOLERANCE = 0.01
"""The search ends when a step is shorter than this part of the range, or gains less of the misfit."""


@dataclass(frozen=True)
class Goal:
    """What a fit is for.

    Attributes:
        solver: whose factors are sought; its own are where the search begins.
        scenes: to fit to.
        references: the fine deposit of each.
        weights: of the errors of front, mean height and map, [3].
        interval: time between frames [s].
        seed: of the particles' placement in the first scene; the next scene has the next one.
    """

    solver: FittedSolver
    scenes: Sequence[Scene]
    references: Sequence[Observed]
    weights: Floats
    interval: float
    seed: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the factors, in the order of the unknowns, which are their logarithms."""
        return tuple(vars(self.solver.factors))

    def factors(self, values: Sequence[float]) -> Factors:
        """Return factors of the solver from their values, in the order of `names`."""
        return replace(self.solver.factors, **dict(zip(self.names, values, strict=True)))

    def errors(self, factors: Factors, shift: int = 0) -> Floats:
        """Return the errors of front, mean height and map of every scene [S, 3].

        Args:
            factors: with which all scenes are run, one a core.
            shift: of the seeds.
        """
        solver = replace(self.solver, factors=factors)

        def missed(number: int) -> Floats:
            seed = self.seed + shift + number
            try:
                trajectory = solver.run(self.scenes[number], interval=self.interval, seed=seed)
            except SimulationError:
                return np.full(3, FAILED)
            return errors(observe(trajectory), self.references[number])

        with ThreadPoolExecutor(available_cores()) as pool:  # the kernels let other threads run
            return np.array(list(pool.map(missed, range(len(self.scenes)))))


class Runs:
    """All runs of a fit so far, in a file: factors, and errors of every scene.

    Args:
        path: the file; made at the first run.
        identity: hash of all that decides what a run gives.

    Raises:
        InputError: the file holds runs of another fit.
    """

    def __init__(self, path: Path, identity: str) -> None:
        self.path, self.identity = path, identity
        self.errors: dict[tuple[float, ...], Floats] = {}
        if path.is_file():
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["identity"] != identity:
                raise InputError(
                    f"{path}: holds runs of other scenes, settings or version; remove it or choose another out=."
                )
            self.errors = {tuple(factors): np.array(values) for factors, values in content["runs"]}

    def add(self, factors: tuple[float, ...], values: Floats) -> None:
        """Add a run, and write them all."""
        self.errors[factors] = values
        runs = [[list(key), value.tolist()] for key, value in self.errors.items()]
        write_atomically(self.path, json.dumps({"identity": self.identity, "runs": runs}).encode())


def search(goal: Goal, bounds: Mapping[str, Sequence[float]], *, difference: float, budget: int, runs: Runs) -> Factors:
    """Return the factors with the least weighted sum of squared errors, as far as it is found.

    Gauss–Newton in a trust region: each error of each scene tells something of every factor.

    Args:
        goal: what is sought.
        bounds: name of a factor → least and largest.
        difference: of ln(factor), by which slopes are measured.
        budget: runs of all scenes, about.
        runs: made before, and where new ones are kept.

    Raises:
        InputError: bounds of other names, not positive, or without the factors where the search begins.
    """
    names = goal.names
    if set(bounds) != set(names) or not all(0 < low < high for low, high in bounds.values()):
        raise InputError(f"bounds: needs two positive numbers, the smaller first, for each of {', '.join(names)}.")
    lower, upper = (np.log([bounds[name][side] for name in names]).tolist() for side in (0, 1))
    box, start = Bounds(lower, upper), np.log(list(vars(goal.solver.factors).values())).tolist()
    if np.any(np.abs(box.share(start) - 0.5) > 0.5):
        raise InputError("bounds: the factors with which the search begins (start=, or 1 each) must lie between them.")

    def residual(logarithms: Floats) -> Floats:
        factors = tuple(np.round(np.exp(logarithms), 6).tolist())
        if factors not in runs.errors:
            runs.add(factors, goal.errors(goal.factors(factors)))
            words = described(dict(zip(names, factors, strict=True)), runs.errors[factors])
            print(f"run {len(runs.errors)} of about {budget}: {words}", flush=True)
        return np.asarray((goal.weights * runs.errors[factors]).ravel())

    solve(
        residual,
        start,
        box,
        difference=difference / float(box.extent.max()),
        tolerance=TOLERANCE,
        most=max(1, budget // (len(names) + 1)),
    )
    best = min(runs.errors, key=lambda key: float(((goal.weights * runs.errors[key]) ** 2).sum()))
    return goal.factors(best)


def described(factors: Mapping[str, float], values: Floats) -> str:
    """Return errors and factors in words.

    Args:
        factors: by their names.
        values: errors of every scene [S, 3].
    """
    front, height, misplaced = np.sqrt(np.mean(values**2, axis=0))
    named = ", ".join(f"{name} {value:.3g}" for name, value in factors.items())
    return f"front {100 * front:.1f} %, mean height {100 * height:.1f} %, map {misplaced:.3f} rms; {named}"
