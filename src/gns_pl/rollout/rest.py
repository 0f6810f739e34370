"""Only what moves: particles at rest fall asleep, and a scene whose particles all rest is done.

A particle is still while neither it nor a neighbour moves faster than a threshold. One that has been still for some
steps sleeps: it stays where it is and gets no messages; what is awake still feels it. It wakes when a neighbour moves.
"""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.graph import Static
from gns_pl.simulator import Simulator

STEPS = 5
"""A particle that was still for so many steps sleeps; a scene whose particles all were is at rest."""


class Rest:
    """Whether scenes have come to rest, from the steps that they make.

    Args:
        speed: below which a particle is at rest [m/s].
        share: of a scene's particles that have to be, for `STEPS` steps in a row.

    Attributes:
        rested: numbers of the scenes that have come to rest.
    """

    def __init__(self, speed: float, share: float = 1.0) -> None:
        if not speed > 0:
            raise InputError(f"the speed below which a scene rests must be positive, not {speed}.")
        self.speed, self.share = speed, share
        self.rested: set[int] = set()
        self._still: dict[int, int] = {}

    def reached(self, scene: int, before: Tensor, after: Tensor, dt: float) -> bool:
        """Return whether a scene is at rest after one more step.

        Args:
            scene: its number.
            before: positions before the step [N, D] [m].
            after: behind it [N, D] [m].
            dt: its time [s].
        """
        slow = (after - before).square().sum(dim=1) < (self.speed * dt) ** 2
        still = bool(slow.float().mean() >= self.share)
        self._still[scene] = self._still.get(scene, 0) + 1 if still else 0
        if self._still[scene] >= STEPS:
            self.rested.add(scene)
        return scene in self.rested


class SleepingStep:
    """Steps of a simulator in which particles at rest sleep.

    Args:
        simulator: whose steps these are; without gradients.
        speed: below which a particle is still [m/s].
        halo: how far around what is awake messages are still passed, in connectivity radii. As many as the network has
            message-passing steps, and what is awake moves as if the sleeping ones got their messages too; fewer are
            cheaper.

    Attributes:
        awake: which particles moved in the latest step [N] bool; empty before the first.
    """

    def __init__(self, simulator: Simulator, speed: float, halo: int = 1) -> None:
        self.simulator = copy.copy(simulator)
        self.simulator._modules = dict(simulator._modules)
        self.simulator._modules["network"] = _Awake(simulator.network, self)
        self._search = simulator.search
        self.simulator.search = self._find
        self.speed, self.halo = speed, halo
        self.awake = self.reached = torch.empty(0, dtype=torch.bool)
        self._still = torch.empty(0, dtype=torch.int32)
        self._moving = torch.empty(0, dtype=torch.bool)
        self._static: Static | None = None

    def __call__(self, history: Tensor, static: Static) -> Tensor:
        """Return the positions one step later; arguments as those of the simulator."""
        if self._static is not static:
            self._static = static
            self._still = torch.zeros(len(history), dtype=torch.int32, device=history.device)
        step = self.speed * self.simulator.config.dt
        self._moving = (history[:, -1] - history[:, -2]).square().sum(dim=1) >= step**2
        position = self.simulator(history, static)
        return torch.where(self.awake[:, None], position, history[:, -1])

    def _find(self, *arguments: object, **settings: object) -> Tensor:
        """Search neighbours, and find out who sleeps."""
        edge_index: Tensor = self._search(*arguments, **settings)
        sender, receiver = edge_index
        felt = self._moving.index_fill(0, receiver[self._moving[sender]], True)
        self._still = torch.where(felt, 0, self._still + 1)
        self.awake = self.reached = self._still < STEPS
        for _ in range(self.halo):
            self.reached = self.reached.index_fill(0, sender[self.reached[receiver]], True)
        return edge_index


class _Awake(nn.Module):
    """A network that works on what is awake and what that sees; the others' outputs are zero."""

    def __init__(self, network: nn.Module, step: SleepingStep) -> None:
        super().__init__()
        self.network = network
        self.step = step

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        reached = self.step.reached
        if bool(reached.all()):
            return cast(Tensor, self.network(node, edge, edge_index))
        kept = reached[edge_index[1]]
        edge_index, edge = edge_index[:, kept], edge[kept]
        seen = reached.index_fill(0, edge_index[0], True)
        number = seen.cumsum(0) - 1
        output = cast(Tensor, self.network(node[seen], edge, number[edge_index]))
        whole = output.new_zeros(len(node), output.shape[1])
        whole[seen] = output
        return whole
