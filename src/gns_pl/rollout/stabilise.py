"""What keeps a run within physical limits, without touching the network: wrappers around a step, each to be had alone.

Each undoes one way in which learned runs fail (`rollout.failure`): particles on top of each other, energy out of
nothing, heaps that never rest. docs/stability.md has what each is worth. Whichever is asked for, what flies freely
keeps its momentum.

Derivatives go through such steps as well, for training on whole runs: particles that were moved apart have those of the
step before it (straight-through, Bengio et al. 2013), velocities that were scaled down those of the factor held.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, radius_graph
from gns_pl.graph.cells import all_finite
from gns_pl.machine import compiles
from gns_pl.models.simulator import Search
from gns_pl.rollout.loops import flight_offset, move_apart, slowing
from gns_pl.rollout.rest import SleepingStepper
from gns_pl.rollout.stepper import Stepper, opened

SWEEPS = 4
"""Times that all pairs which are too close are moved apart, in a step."""

ROUNDING = 2e-6
"""What single precision does to free fall in a step: by so much of it a scene's energy may rise, and by so much of its
box's edges a centre of mass may be off."""


def stabilise(
    stepper: Stepper,
    *,
    sleep: float = 0.0,
    min_distance: float = 0.0,
    energy_limiter: bool = False,
) -> Stepper:
    """Return what makes the same steps, where these stay within physical limits.

    A simulator whose steps are those of another program, and equal to them, comes back as it is.

    Args:
        stepper: stays as it is; `acceleration.accelerate` goes first.
        sleep: particles slower than this for some steps, their neighbours too, stay where they are (`rest`) [m/s].
        min_distance: particles nearer than so many spacings are moved apart after the step; 0: they are not.
        energy_limiter: a step that raises the energy of motion and height has its velocities scaled down, all of a
            scene's by one factor, until it does not. Before anything can sleep, motion slower than that, as root of the
            mean square, is free: what begins would be held by an error as small as that in every step, and never begin.

    Raises:
        InputError: a negative limit, or distances that no filling keeps.
    """
    if not 0 <= min_distance < 1:
        raise InputError(f"stabilise.min_distance must lie in [0, 1) spacings, not {min_distance}.")
    if not sleep >= 0:
        raise InputError(f"stabilise.sleep must be a speed of 0 or more, not {sleep}.")
    if stepper.config.exact_steps or not (sleep or min_distance or energy_limiter):
        return stepper
    open_stepper = opened(stepper)
    found = FoundPairs(open_stepper.search) if open_stepper is not None and min_distance else None
    if open_stepper is not None and found is not None:
        stepper = replace(open_stepper, search=found)
    return StableStepper(
        SleepingStepper(stepper, sleep) if sleep else stepper, min_distance, energy_limiter, found, sleep
    )


class FoundPairs:
    """A search that remembers what it found last.

    Args:
        search: finds neighbours.

    Attributes:
        pairs: edges [2, E]; None if nothing was searched.
        position: in which they were found [N, D] [m].
        radius: within which [m].
    """

    def __init__(self, search: Search) -> None:
        self._search, self.position, self.radius = search, torch.empty(0), 0.0
        self.pairs: Tensor | None = None

    def __call__(self, position: Tensor, radius: float, *arguments: object, **settings: object) -> Tensor:
        """Return the edges of a graph; arguments as those of `radius_graph`."""
        self.pairs, self.position, self.radius = None, position.detach(), radius
        found = self._search(position, radius, *arguments, **settings)
        self.pairs = found
        return found


class StableStepper:
    """Steps that are corrected one after the other: momentum, distances, then energy.

    Args:
        stepper: makes the steps.
        min_distance: as of `stabilise`.
        energy_limiter: as of `stabilise`.
        found: the pairs that the steps find.
        slow: root of the mean square speed up to which the energy of a run that begins is not limited [m/s].
    """

    def __init__(
        self,
        stepper: Stepper,
        min_distance: float,
        energy_limiter: bool,
        found: FoundPairs | None = None,
        slow: float = 0.0,
    ) -> None:
        self._found = found
        self._stepper, self.min_distance, self.energy_limiter = stepper, min_distance, energy_limiter
        self._slow = 0.5 * slow**2
        self.config, self.device, self.history_length = stepper.config, stepper.device, stepper.history_length

    def __call__(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the positions one step later; arguments as those of the simulator, with `history_length` positions."""
        if self._found is not None:
            self._found.pairs = None
        position = self._stepper(history, scenes)
        offset = self._flight_offset(history, position, scenes)
        if offset is not None:
            position = torch.where(scenes.moved[:, None], position - offset, position)
        if self.min_distance:
            apart = self._apart(position.detach(), scenes)
            # The difference is zero: it takes the derivative past the shifts, and leaves the numbers as they are.
            position = apart + (position - position.detach()) if position.requires_grad else apart
        if self.energy_limiter:
            factor, before = self._dissipating(history.detach(), position.detach(), scenes), history[:, -1]
            if factor is not None:
                position = torch.where(factor < 1, before + factor.to(position.dtype) * (position - before), position)
        return torch.where(scenes.moved[:, None], position, history[:, -1])

    def _flight_offset(self, history: Tensor, position: Tensor, scenes: SceneBatch) -> Tensor | None:
        """Return how far the centres of mass are from free flight, x + v Δt + g Δt², of every particle [N, D] [m].

        None where nothing flies, if that is known without waiting. A scene flies while all of it is further than the
        connectivity radius from every wall, before and behind the step: no force is then there but gravity and those
        between particles, which cancel (Newton's third law). Those of a network do not. Where something rigid stands in
        the box, or a script moves particles, nothing is known to fly. Particles weigh what they fill.
        """
        if scenes.surfaces is not None and scenes.surfaces.inner:
            return None
        earlier, before = history[:, -2], history[:, -1]
        known, boxes = (scenes.volume, scenes.moved, scenes.batch), (scenes.gravity, scenes.lower, scenes.upper)
        dt, radius = self.config.dt, self.config.connectivity_radius
        if compiles(earlier, before, position, scenes.volume, *boxes):
            tensors = (earlier, before, position, *known, *boxes)
            offset = flight_offset(dt, radius, ROUNDING, *(tensor.numpy() for tensor in tensors))
            return scenes.of_particles(torch.from_numpy(offset)) if offset.any() else None
        lower, upper = scenes.of_particles(scenes.lower), scenes.of_particles(scenes.upper)
        room = torch.minimum(torch.minimum(before, position) - lower, upper - torch.maximum(before, position))
        held = ~(room > radius).all(dim=1) | ~scenes.moved
        fall = position - 2 * before + earlier - scenes.of_particles(scenes.gravity) * dt**2
        weighed = scenes.volume[:, None] * torch.cat([fall, held[:, None], torch.ones_like(fall[:, :1])], dim=1)
        sums = weighed.new_zeros(scenes.num_graphs, weighed.shape[1], dtype=torch.float64)
        sums = sums.index_add_(0, scenes.batch, weighed.double())
        offset = sums[:, :-2] / sums[:, -1:]
        off = (sums[:, -2:-1] == 0) & (offset.abs() > ROUNDING * (scenes.upper - scenes.lower))
        return scenes.of_particles(torch.where(off, offset, 0.0).to(position.dtype))

    def _apart(self, position: Tensor, scenes: SceneBatch) -> Tensor:
        """Move particles apart that are too close, each by half of what is missing, some times over."""
        least = self.min_distance * self.config.spacing
        lower, upper = scenes.of_particles(scenes.lower), scenes.of_particles(scenes.upper)
        if compiles(position, scenes.lower):
            return torch.from_numpy(self._apart_in_loops(position, scenes, least))
        if not bool(torch.isfinite(position).all()):
            return position
        for _ in range(SWEEPS):
            sender, receiver = radius_graph(position, least, scenes.batch, num_graphs=scenes.num_graphs)
            if len(sender) == 0:
                break
            away = position[receiver] - position[sender]
            distance = away.norm(dim=1, keepdim=True)
            aside = torch.zeros_like(away)  # for two in one place: the one of the higher number goes up
            aside[:, -1] = torch.where(receiver > sender, 1.0, -1.0)
            direction = torch.where(distance > 1e-6 * least, away / distance.clamp_min(1e-12), aside)
            shift = torch.zeros_like(position).index_add_(0, receiver, 0.5 * (least - distance) * direction)
            position = torch.clamp(position + shift, lower, upper)
        return position

    def _apart_in_loops(self, position: Tensor, scenes: SceneBatch, least: float) -> NDArray[np.float32]:
        """Return what `_apart` does, from the pairs that the step has found where these will do."""
        place, found, sweeps = position.numpy().copy(), self._found, SWEEPS
        boxes = [value.numpy() for value in (scenes.batch, scenes.lower, scenes.upper)]
        if not (len(place) and all_finite(place)):
            return place
        if found is not None and found.pairs is not None and compiles(found.position):
            known = (found.position.contiguous().numpy(), found.radius, found.pairs.numpy())
            sweeps = move_apart(place, *known, np.float32(least), sweeps, *boxes)
        while sweeps:
            position = torch.from_numpy(place)
            pairs = radius_graph(position, 2 * least, scenes.batch, num_graphs=scenes.num_graphs)
            sweeps = move_apart(place, place.copy(), 2 * least, pairs.numpy(), np.float32(least), sweeps, *boxes)
        return place

    def _dissipating(self, history: Tensor, position: Tensor, scenes: SceneBatch) -> Tensor | None:
        """Return what scales velocities down where energy rose: the largest s in [0, 1] with E(s) ≤ E_before [N, 1].

        None where none is to be scaled, if that is known without waiting.

        E(s) = Σ m (s² v²/2 − g · (x + s v Δt/2)) is quadratic in s: the energy in the middle of the step, which free
        fall keeps. Particles weigh what they fill, exact for one density; a halt is what is left where no s does. Where
        kinematic particles move they do work, and nothing is scaled.
        """
        frames = (history[:, -2], history[:, -1], position)
        slow = self._slow * history[:, 0, 0].isnan().double()  # of scenes that begin (`rest.SleepingStepper`)
        if compiles(*frames, scenes.volume, scenes.gravity, scenes.lower):
            boxes = (scenes.gravity, scenes.lower, scenes.upper)
            tensors = (slow, *frames, scenes.volume, scenes.moved, scenes.batch, *boxes)
            scales = slowing(self.config.dt, ROUNDING, *(tensor.numpy() for tensor in tensors))
            return scenes.of_particles(torch.from_numpy(scales)[:, None]) if (scales < 1).any() else None
        quadratic, linear, height, past, pushed, motion, free = self._energies(frames, scenes, slow).unbind(1)
        allowed = (past + height) * (1 + ROUNDING) - height + (free - motion).clamp_min(0)
        root = (linear.square() + 4 * quadratic * allowed).clamp_min(0).sqrt()
        factor = ((root - linear) / (2 * quadratic).clamp_min(1e-30)).clamp(0, 1)
        factor = torch.where((pushed > 0) | (quadratic + linear <= allowed), 1.0, factor)
        return scenes.of_particles(factor[:, None])

    def _energies(self, frames: tuple[Tensor, Tensor, Tensor], scenes: SceneBatch, slow: Tensor) -> Tensor:
        """Return of every scene, in double precision, what its energy is made of [B, 7].

        Energy of motion behind the step; what height adds in its middle, with the opposite sign; height before it;
        motion and height of the step before; motion of what a script moves; motion of the step before; what that
        may be without a cause.

        Args:
            frames: positions two steps ago, one step ago and now, each [N, D] [m].
            scenes: those that are stepped.
            slow: motion of every particle that is free, per mass [N] [m²/s²].
        """
        dt, volume, gravity = self.config.dt, scenes.volume, scenes.gravity
        lowest = torch.where(gravity > 0, scenes.upper, scenes.lower)
        earlier, before, position = frames
        gravity, lowest = scenes.of_particles(gravity), scenes.of_particles(lowest)
        velocity, past = (position - before) / dt, (before - earlier) / dt
        motion = past.square().sum(1)
        values = [
            velocity.square().sum(1) / 2,
            -(gravity * velocity).sum(1) * dt / 2,
            ((lowest - before) * gravity).sum(1),
            motion / 2 + (gravity * past).sum(1) * dt / 2,
            motion * ~scenes.moved,
            motion / 2,
            slow.to(motion),
        ]
        weighed = (volume[:, None] * torch.stack(values, dim=1)).double()
        return weighed.new_zeros(scenes.num_graphs, len(values)).index_add_(0, scenes.batch, weighed)
