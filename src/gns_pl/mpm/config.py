"""Settings of the solver, checked at construction, and the error of a run that failed."""

from __future__ import annotations

from dataclasses import dataclass

from gns_pl.errors import InputError
from gns_pl.scene.checks import checked_number

COURANT_LIMIT = 0.6
"""Largest Courant number that is accepted unasked. Up to it the runout of a column changes by less than 1 %; beyond
about 1 it drifts, by 10 % at 1.9, without a sign of failure (docs/reference.md)."""

TRANSFERS = ("flip", "apic", "pic")


class SimulationError(InputError):
    """A scene and settings whose run became unstable or non-finite; the message names the scene and the time."""


@dataclass(frozen=True)
class MPMConfig:
    """How a scene is discretised and stepped.

    Attributes:
        cell_size: wanted edge of a grid cell [m]; each axis takes the nearest size that divides the box, so that
            every wall lies on grid nodes.
        points_per_direction: material points along each edge of a cell.
        courant: time step over `cell_size` / (P-wave speed + largest expected speed).
        transfer: "flip" (affine FLIP with a damping rate), "apic" or "pic"; the last two damp per step, so they
            freeze as the time step goes to zero.
        damping_rate: rate at which the FLIP velocity of a point goes over to the grid's [1/s]: the FLIP fraction of
            a step is exp(−rate · dt). Only for "flip".
        viscosity_time: τ of the bulk viscosity, pressure −τ K div v of points in contact [s].
        jitter: largest random offset of a point from its lattice place, in halves of the spacing, in [0, 1).
        allow_large_courant: accept a Courant number above `COURANT_LIMIT`.

    Raises:
        InputError: a number out of its range, in one sentence.
    """

    cell_size: float
    points_per_direction: int
    courant: float
    transfer: str
    damping_rate: float
    viscosity_time: float
    jitter: float
    allow_large_courant: bool = False

    def __post_init__(self) -> None:
        for name in ("cell_size", "courant"):
            object.__setattr__(self, name, checked_number("mpm", name, getattr(self, name), 0.0, above=True))
        for name in ("damping_rate", "viscosity_time", "jitter"):
            object.__setattr__(self, name, checked_number("mpm", name, getattr(self, name), 0.0))
        if self.jitter >= 1:
            raise InputError(f"mpm: jitter must lie in [0, 1), not {self.jitter}.")
        points = checked_number("mpm", "points_per_direction", self.points_per_direction, 1.0)
        if points != int(points):
            raise InputError(f"mpm: points_per_direction must be a whole number, not {self.points_per_direction}.")
        object.__setattr__(self, "points_per_direction", int(points))
        if self.transfer not in TRANSFERS:
            raise InputError(f"mpm: transfer must be one of {', '.join(TRANSFERS)}, not {self.transfer!r}.")
        if self.courant > COURANT_LIMIT and not self.allow_large_courant:
            raise InputError(
                f"mpm: courant {self.courant:g} is above the limit of {COURANT_LIMIT:g}; choose a smaller one or set "
                f"allow_large_courant=true."
            )

    @property
    def spacing(self) -> float:
        """Distance of neighbouring material points at the start [m]."""
        return self.cell_size / self.points_per_direction
