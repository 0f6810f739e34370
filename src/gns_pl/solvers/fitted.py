"""Solvers of few scalars that were fitted to fine MPM: the scalars, and the range of the scenes they were fitted to.

Coarse cells, and a layer, err in a way that a slightly different material makes up for. What that material is depends
on the cells over the bodies' size, so that a fit holds for one such number; `inverse.solver_fit` finds it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gns_pl.scene import Scene
from gns_pl.scene.checks import checked_number
from gns_pl.solvers.fitted_range import beyond
from gns_pl.solvers.solver import Solver, hashed


@dataclass(frozen=True)
class Factors:
    """By what a solver changes scalars of a scene or of its own; 1 each is the solver as it was before the fit.

    Raises:
        InputError: a factor that is not positive.
    """

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, checked_number("factors", name, value, 0.0, above=True))


@dataclass(frozen=True)
class FittedSolver(Solver):
    """What solvers with fitted scalars share; mixed into the solver that is fitted.

    Attributes:
        name: of the solver.
        cells: over √(L0 H0), for which the factors were fitted.
        settings: of the solver that is fitted, but for the cells.
        factors: that were fitted.
        fitted_range: of the scenes that they were fitted to (`fitted_range.range_of`).
        path: of the file it was read from.
    """

    name: str
    cells: float
    settings: Mapping[str, Any]
    factors: Factors = field(default_factory=Factors)
    fitted_range: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None

    def identity(self) -> str:
        """Return a hash of all that decides what a run gives."""
        return hashed([super().identity(), vars(self.factors)])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return what the solver says of itself, and the factors."""
        return {**super().facts(scene), "factors": dict(vars(self.factors))}

    def out_of_range_reason(self, scene: Scene) -> str | None:
        """Return what of a scene is outside the range of the scenes it was fitted to, or None."""
        return "; ".join(beyond(scene, self.fitted_range)) or None

    def file(self) -> Path | None:
        """Return the file it was read from."""
        return self.path
