"""Only what moves: particles at rest fall asleep, and a scene whose particles all rest is done.

A particle sleeps while neither it nor a neighbour has moved faster than a threshold for some steps: it stays where it
is and gets no messages; what is awake still feels it. It wakes when a neighbour moves.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, radius_graph
from gns_pl.machine import compiles
from gns_pl.rollout.loops import is_moving, passed, spread
from gns_pl.rollout.stepper import Stepper, opened

REST_STEPS = 5
"""A particle that was still for so many steps sleeps; a scene whose particles all were is at rest."""


class Rest:
    """Whether scenes have come to rest, from the steps that they make.

    Args:
        speed: below which a particle is at rest [m/s].
        share: of a scene's particles that have to be, for `REST_STEPS` steps in a row.

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
        if self._still[scene] >= REST_STEPS:
            self.rested.add(scene)
        return scene in self.rested


class SleepingStepper:
    """Steps in which particles at rest sleep.

    Args:
        stepper: makes the steps. One whose step is closed passes all messages.
        speed: below which a particle is still [m/s].

    Whether somebody sleeps depends on the latest positions alone, so that a run that goes on later goes on as it was.

    Attributes:
        awake: which particles moved in the latest step [N] bool; empty before the first.
        history_length: positions that a step looks at. In the first `REST_STEPS` − 1 steps of a run the earliest of
            them are NaN, and nobody sleeps, however long the simulator's own history is: its positions before the
            start are made up, and those of a start from rest never move.
    """

    def __init__(self, stepper: Stepper, speed: float) -> None:
        self._stepper, self._open, self._search = stepper, opened(stepper), radius_graph
        if self._open is not None:
            self._search, self._network = self._open.search, self._open.network
            self._stepper = replace(self._open, search=self._find, network=self._evaluate)
        self.config, self.device, self.speed = stepper.config, stepper.device, speed
        self.history_length = stepper.history_length + REST_STEPS - 1
        self.awake = self._reached = self._moving = torch.empty(0, dtype=torch.bool)

    def __call__(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the positions one step later; arguments as those of the simulator, with `history_length` positions."""
        step, config = self.speed * self.config.dt, self.config
        self._moving = _moving(history.detach(), step)  # nothing of it has a derivative
        if not bool(self._moving.any()):  # then nobody wakes either
            self.awake = self._moving
            return history[:, -1]
        recent = history[:, -self._stepper.history_length :]
        if self._open is None:
            self._find(recent[:, -1], config.connectivity_radius, scenes.batch, num_graphs=scenes.num_graphs)
        position = self._stepper(recent, scenes)  # finds out who is awake
        return torch.where(self.awake[:, None], position, history[:, -1])

    def _find(self, *arguments: object, **settings: object) -> Tensor:
        """Search neighbours, and find out who sleeps."""
        edge_index: Tensor = self._search(*arguments, **settings)  # type: ignore[arg-type]
        if edge_index.device.type == "cpu":
            awake, reached = spread(edge_index.numpy(), self._moving.numpy())
            self.awake, self._reached = torch.from_numpy(awake), torch.from_numpy(reached)
            return edge_index
        sender, receiver = edge_index
        self.awake = self._moving.index_fill(0, receiver[self._moving[sender]], True)
        # Messages are passed one radius around what is awake: exact for two layers (docs/reductions.md).
        self._reached = self.awake.index_fill(0, sender[self.awake[receiver]], True)
        return edge_index

    def _evaluate(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Evaluate the network on what is awake and what that sees; the others' outputs are zero."""
        reached = self._reached
        if bool(reached.all()):
            return self._network(node, edge, edge_index)
        if compiles(edge, backward=True):
            edges, kept, visible = map(torch.from_numpy, passed(edge_index.numpy(), reached.numpy()))
            output = self._network(node.index_select(0, visible), edge.index_select(0, kept), edges)
            return output.new_zeros(len(node), output.shape[1]).index_copy(0, visible, output)
        received = reached[edge_index[1]]
        edge_index, edge = edge_index[:, received], edge[received]
        visible = reached.index_fill(0, edge_index[0], True)
        number = visible.cumsum(0) - 1
        output = self._network(node[visible], edge, number[edge_index])
        whole = output.new_zeros(len(node), output.shape[1])
        whole[visible] = output
        return whole


def _moving(history: Tensor, step: float) -> Tensor:
    """Return which particles made one of the latest `REST_STEPS` steps at `step` [m] or more, or are not known [N]."""
    if history.shape[1] <= REST_STEPS:
        return torch.ones(len(history), dtype=torch.bool, device=history.device)
    if compiles(history):
        return torch.from_numpy(is_moving(history.numpy(), REST_STEPS, step))
    slow = history[:, -REST_STEPS - 1 :].diff(dim=1).square().sum(dim=2) < step**2
    return ~slow.all(dim=1) | history.isnan().any(dim=2).any(dim=1)
