"""Runs of one scene from several placements of its particles: their mean is the headline, their scatter beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gns_pl.metrics.curves import CURVES, Curves, cut, num_finite_frames
from gns_pl.metrics.measures import Floats
from gns_pl.metrics.summary import FLOW, Measured, flow_errors
from gns_pl.trajectory import Trajectory

Band = tuple[Floats, Floats]
"""Lowest and highest value of the placements in every frame, both [T]."""


@dataclass(frozen=True)
class Placements:
    """What runs of one scene from several placements of its particles did.

    Attributes:
        curves: mean of those that reached the end, name → [T]; None if none did.
        band: name of a curve → its range over them.
        values: entry of `flow_errors` → its value in every run; NaN in one that did not reach the end.
    """

    curves: Curves | None
    band: dict[str, Band]
    values: dict[str, list[float]]

    @classmethod
    def of(cls, runs: Sequence[Trajectory], whole: Measured) -> Placements:
        """Measure runs against all points of the reference.

        Args:
            runs: one at least, at the reference's time step; one that ended early or is not finite has failed.
            whole: the reference.
        """
        length = whole.trajectory.num_frames
        values: dict[str, list[float]] = {name: [] for name in FLOW}
        reached: list[Curves] = []
        for run in runs:
            errors: dict[str, float] = {}
            if num_finite_frames(run) >= length:
                measured = Measured(cut(run, length))
                errors = flow_errors(measured, whole)
                reached.append(measured.curves)
            for name in FLOW:
                values[name].append(errors.get(name, np.nan))
        if not reached:
            return cls(None, {}, values)
        members = {quantity.name: np.stack([curves[quantity.name] for curves in reached]) for quantity in CURVES}
        mean = {name: curves.mean(axis=0) for name, curves in members.items()}
        return cls(mean, {name: (curves.min(axis=0), curves.max(axis=0)) for name, curves in members.items()}, values)

    def over(self, statistic: Any) -> dict[str, float]:
        """Return a statistic of every entry over the runs that reached the end; entries that none has are left out."""
        finite = {name: [value for value in numbers if np.isfinite(value)] for name, numbers in self.values.items()}
        return {name: float(statistic(numbers)) for name, numbers in finite.items() if numbers}
