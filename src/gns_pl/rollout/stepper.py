"""What makes a step: the type that the loop takes, and a simulator's own step by another search or another network.

`accelerate`, `stabilise` and `distribute` each take a `Stepper` and return one; a `Simulator` is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from gns_pl.graph import SceneBatch, radius_graph
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.simulator import Evaluation, Search, Simulator


class Stepper(Protocol):
    """Makes steps of scenes; with gradients if it is a simulator itself, or one that is stabilised and nothing more."""

    @property
    def config(self) -> SimulatorConfig:
        """Of the simulator."""

    @property
    def history_length(self) -> int:
        """Positions that a step looks at; those that were never made before a simulator's own H are NaN."""

    @property
    def device(self) -> torch.device:
        """Where history and scenes have to be."""

    def __call__(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the positions one step later [N, D] [m].

        Args:
            history: positions of the last `history_length` frames, the latest last [N, ≥ H, D] [m].
            scenes: those that are stepped.
        """


@dataclass(frozen=True)
class SimulatorStepper:
    """A simulator's step, its neighbours found and its network evaluated as told.

    Attributes:
        simulator: whose features, integration and statistics are used.
        search: finds the neighbours.
        network: evaluated in the place of the simulator's own.
    """

    simulator: Simulator
    search: Search
    network: Evaluation

    @property
    def config(self) -> SimulatorConfig:
        """Of the simulator."""
        return self.simulator.config

    @property
    def history_length(self) -> int:
        """H."""
        return self.simulator.history_length

    @property
    def device(self) -> torch.device:
        """Of the simulator's weights."""
        return self.simulator.device

    def __call__(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the positions one step later [N, D] [m]; arguments as those of the simulator."""
        position: Tensor = self.simulator(history, scenes, search=self.search, network=self.network)
        return position

    def normalised_acceleration(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the network's output in the simulator's units [N, D]; arguments as those of the simulator."""
        return self.simulator.normalised_acceleration(history, scenes, search=self.search, network=self.network)


def opened(stepper: Stepper) -> SimulatorStepper | None:
    """Return a stepper whose search and network can be replaced; None for a closed one, such as a CUDA graph."""
    if isinstance(stepper, Simulator):
        return SimulatorStepper(stepper, radius_graph, stepper.network)
    return stepper if isinstance(stepper, SimulatorStepper) else None
