"""How learned simulators are run: one policy for files, evaluation, validation, charts, notebooks and Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gns_pl.models.checkpoint import Checkpoint
from gns_pl.presets import preset
from gns_pl.rollout.acceleration import accelerate
from gns_pl.rollout.distributed import distribute
from gns_pl.rollout.rest import Rest
from gns_pl.rollout.stabilise import stabilise
from gns_pl.rollout.stepper import Stepper

STILL = 1e-9
"""Speed below which a particle that sleeps has not moved at all [m/s]."""


@dataclass(frozen=True)
class Policy:
    """How learned simulators are run.

    Attributes:
        stabilise: arguments of `rollout.stabilise.stabilise`; conf/rollout/stable.yaml unless others are given.
        acceleration: arguments of `rollout.acceleration.accelerate`.
        rest_speed: a run ends when all particles were slower for some steps [m/s]. At 0 it ends when no particle moves
            at all, which leaves nothing out: particles that sleep stay where they are.
        every: a watched run is looked at every so many frames; all of them cost a small scene a tenth of its time.
    """

    stabilise: Mapping[str, Any] = field(default_factory=lambda: preset("rollout/stable"))
    acceleration: Mapping[str, Any] = field(default_factory=dict)
    rest_speed: float = 0.0
    every: int = 10

    def stepper(self, checkpoint: Checkpoint, *, shared: bool = False) -> Stepper:
        """Return what makes the steps of a checkpoint's simulator.

        Args:
            checkpoint: with the simulator.
            shared: every step is made by all processes of the default group together. In a training, whose processes
                validate other trajectories each, it is not.
        """
        stepper = accelerate(checkpoint.simulator, **self.acceleration)
        return stabilise(distribute(stepper) if shared else stepper, **self.stabilise)

    def rest(self) -> Rest | None:
        """Return what ends runs, or None where nothing ends them early."""
        speed = self.rest_speed or (STILL if self.stabilise.get("sleep") else 0.0)
        return Rest(speed) if speed else None
