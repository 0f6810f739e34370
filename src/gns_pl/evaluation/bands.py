"""Bands: one scene by several simulators, or from several placements, and how far apart they come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.measures import Floats
from gns_pl.rollout import rollout
from gns_pl.rollout.stepper import Stepper
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class Bands:
    """A curve over its members.

    Attributes:
        time: [T] [s].
        members: [M, T]; NaN behind the last frame of a member that failed.
    """

    time: Floats
    members: Floats

    @property
    def failed(self) -> int:
        """How many members did not reach the end."""
        return int(np.isnan(self.members[:, -1]).sum())

    @property
    def mean(self) -> Floats:
        """Mean of the members that reached the end [T]; NaN if none did."""
        return np.asarray(self._whole().mean(axis=0))

    @property
    def low(self) -> Floats:
        """Lowest of them [T]."""
        return np.asarray(self._whole().min(axis=0))

    @property
    def high(self) -> Floats:
        """Highest of them [T]."""
        return np.asarray(self._whole().max(axis=0))

    @property
    def width(self) -> float:
        """High − low of the last frame; infinite where a member failed, for that tells as much."""
        return float("inf") if self.failed else float(self.high[-1] - self.low[-1])

    def _whole(self) -> Floats:
        whole = self.members[np.isfinite(self.members[:, -1])]
        return whole if len(whole) else np.full((1, len(self.time)), np.nan)


def ensemble_bands(
    steppers: Sequence[Stepper], starts: Sequence[Trajectory], *, duration: float, name: str = "runout_99"
) -> Bands:
    """Run every simulator from every start and return a measure of all.

    Args:
        steppers: of several trainings, or one; snapshots of one training are too much alike (docs/trust.md).
        starts: one scene placed once or several times (`LearnedSolver.start` with several seeds), one frame each.
        duration: to the last frame [s].
        name: in `CURVES`.

    Returns:
        Curves at the time step of the first.
    """
    interval = steppers[0].config.dt
    number = round(duration / interval) + 1
    members = []
    for stepper in steppers:
        dt = stepper.config.dt
        for start in starts:
            trajectory = rollout(stepper, start, int(np.ceil(duration / dt - 1e-6)))
            failed = "failed_at" in trajectory.provenance
            trajectory = trajectory if dt == interval else trajectory.resampled(interval, None if failed else duration)
            values = compute_curves(trajectory)[name][:number]
            members.append(np.pad(values, (0, number - len(values)), constant_values=np.nan))
    return Bands(np.arange(number, dtype=np.float64) * interval, np.stack(members))
