"""Settings of the solver, checked at construction, and the error of a run that failed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gns_pl.errors import InputError
from gns_pl.mpm.laws import DRUCKER_PRAGER, find_law
from gns_pl.presets import preset
from gns_pl.scene import part_from_dict
from gns_pl.scene.checks import checked_number

COURANT_LIMIT = 0.6
"""Largest Courant number that is accepted unasked. Up to it the runout of a column changes by less than 1 %; beyond
about 1 it drifts, by 10 % at 1.9, without a sign of failure (docs/reference.md)."""

TRANSFERS = {"pic": (0.0, 0.0), "flip": (0.0, 1.0), "apic": (1.0, 0.0), "affine_flip": (1.0, 1.0)}
"""Transfer → which part of the affine momentum points give to the grid, and which part of their own velocity they keep
when they get the grid's change."""

PRESETS = {"paper": "data/cube106_paper", "fast": "choice/default"}
"""Name of a preset → file of the configuration whose "mpm" it is."""

SHAPES = ("quadratic", "linear")
PRECISIONS = ("float64", "float32")


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
        transfer: "affine_flip", "flip", "apic" or "pic". The last two damp per step, so they freeze as the time step
            goes to zero; "apic" with moving-least-squares gradients is MLS-MPM.
        damping_rate: rate at which the FLIP velocity of a point goes over to the grid's [1/s]: the FLIP fraction of
            a step is exp(−rate · dt). Only for the FLIP transfers.
        bulk_viscosity: b of the pressure −b ρ c h div v in points in contact, c the P-wave speed and h the cell; it
            vanishes with the cell.
        jitter: largest random offset of a point from its lattice place, in halves of the spacing, in [0, 1).
        flip_fraction: blend per step of FLIP (1) and PIC or APIC (0), besides the damping rate. Only for the FLIP
            transfers, and only for comparison with codes that blend so: it damps the more the smaller the step.
        local_damping: Cundall's, as codes from statics have it: part of the force on a node that is taken off where it
            speeds the node up and added where it slows it down, gravity included: free fall is slowed too.
        shape: shape functions, "quadratic" or "linear".
        precision: "float64" or "float32", of arrays and arithmetic.
        allow_large_courant: accept a Courant number above `COURANT_LIMIT`.
        law: material law, "drucker_prager", a registered name or "MODULE.FUNCTION" (`laws`).

    Raises:
        InputError: a number out of its range, in one sentence.
    """

    cell_size: float
    points_per_direction: int
    courant: float
    transfer: str
    damping_rate: float
    bulk_viscosity: float
    jitter: float
    flip_fraction: float = 1.0
    local_damping: float = 0.0
    shape: str = "quadratic"
    precision: str = "float64"
    allow_large_courant: bool = False
    law: str = DRUCKER_PRAGER

    @classmethod
    def preset(cls, name: str = "paper", *, cell_size: float, **changes: Any) -> MPMConfig:
        """Return the settings by which the paper's data were made, or the fastest for their error.

        Args:
            name: "paper" (conf/data/cube106_paper.yaml), or "fast" (conf/choice/default.yaml).
            cell_size: wanted edge of a grid cell [m].
            changes: of the other attributes.

        Raises:
            InputError: another name, or settings that are refused.
        """
        if name not in PRESETS:
            raise InputError(f"MPM.preset: there is no {name!r}; there are {' and '.join(PRESETS)}.")
        settings = {**preset(PRESETS[name])["mpm"], **changes, "cell_size": cell_size}
        config: MPMConfig = part_from_dict(cls, "mpm", settings)
        return config

    def __post_init__(self) -> None:
        for name in ("cell_size", "courant"):
            object.__setattr__(self, name, checked_number("mpm", name, getattr(self, name), 0.0, above=True))
        for name in ("damping_rate", "bulk_viscosity", "jitter", "flip_fraction", "local_damping"):
            object.__setattr__(self, name, checked_number("mpm", name, getattr(self, name), 0.0))
        for name in ("jitter", "local_damping"):
            if getattr(self, name) >= 1:
                raise InputError(f"mpm: {name} must lie in [0, 1), not {getattr(self, name)}.")
        points = checked_number("mpm", "points_per_direction", self.points_per_direction, 1.0)
        if points != int(points):
            raise InputError(f"mpm: points_per_direction must be a whole number, not {self.points_per_direction}.")
        object.__setattr__(self, "points_per_direction", int(points))
        for name, known in (("transfer", TRANSFERS), ("shape", SHAPES), ("precision", PRECISIONS)):
            if getattr(self, name) not in known:
                raise InputError(f"mpm: {name} must be one of {', '.join(known)}, not {getattr(self, name)!r}.")
        if self.flip_fraction > 1:
            raise InputError(f"mpm: flip_fraction must lie in [0, 1], not {self.flip_fraction}.")
        if self.courant > COURANT_LIMIT and not self.allow_large_courant:
            raise InputError(
                f"mpm: courant {self.courant:g} is above the limit of {COURANT_LIMIT:g}; choose a smaller one or set "
                f"allow_large_courant=true."
            )
        if not isinstance(self.law, str):
            raise InputError(f"mpm: law must be a name, not {self.law!r}.")
        find_law(self.law)

    @property
    def spacing(self) -> float:
        """Distance of neighbouring material points at the start [m]."""
        return self.cell_size / self.points_per_direction
