"""What is rigid around particles: faces of the box, planes, cuboids and the ground, by distance, normal and friction.

Every surface within a radius pushes away along its normal, by a weight that falls from 1 on it to 0 at the radius, so
that nothing jumps where a surface comes into reach. A network that is shown the sums of these normals, and of these
times the friction, takes slip and rough walls, slopes, barriers and terrain alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor

from gns_pl.graph.contacts import contacts_in_loops, coulomb
from gns_pl.graph.surface_loops import DEEPEST, FLATTEST, normals_of, push_out, see
from gns_pl.machine import compiles


class SurfaceFields(NamedTuple):
    """What particles know of the surfaces around them.

    Attributes:
        approach: Σ w n [N, D], w = 1 − d / R cut at 0, over surfaces with the distance d and the normal n.
        grip: Σ w s n [N, D], s = μ / (1 + μ) of Coulomb friction μ: 0 where all slips, 1 where all sticks.
        ground: height of the highest surface below [N] [m].
    """

    approach: Tensor
    grip: Tensor
    ground: Tensor


@dataclass(frozen=True)
class Surfaces:
    """The rigid surfaces of B scenes, P planes and C cuboids each; those that a scene lacks are out of reach.

    Attributes:
        normal: of the planes, into the open [B, P, D].
        offset: n · x on them [B, P] [m].
        plane_grip: s of them [B, P].
        lower: corner of the cuboids [B, C, D] [m].
        upper: likewise.
        cuboid_grip: s of them [B, C].
        heights: of the grounds, one scene's behind the other's, y running fastest [G] [m]; between them stands a
            quadratic B-spline.
        first: place of a scene's first height [B].
        shape: numbers of heights along the horizontal axes, three at least [B, D − 1].
        corner: place of the first height [B, D − 1] [m].
        cell: distance of heights [B] [m].
        ground_grip: s of the grounds [B].
        inner: whether anything but faces of the box and level floors is among them.
        turn: sign, offset [m] and order of the axes, by which the scenes were mirrored and turned, x' = (sign x +
            offset) in that order, each [B, D]; None if they were not.
    """

    normal: Tensor
    offset: Tensor
    plane_grip: Tensor
    lower: Tensor
    upper: Tensor
    cuboid_grip: Tensor
    heights: Tensor
    first: Tensor
    shape: Tensor
    corner: Tensor
    cell: Tensor
    ground_grip: Tensor
    inner: bool
    turn: tuple[Tensor, Tensor, Tensor] | None = None

    @classmethod
    def joined(cls, each: Sequence[Surfaces]) -> Surfaces:
        """Return the surfaces of several scenes as one."""
        if len(each) == 1:
            return each[0]
        planes, cuboids = (max(getattr(one, name).shape[1] for one in each) for name in ("normal", "lower"))
        begin = torch.tensor([0, *(len(one.heights) for one in each)]).cumsum(0)
        values: dict[str, Any] = {
            name: torch.cat([getattr(one, name) for one in each]) for name in _TENSORS if name not in _PADDED
        }
        for name, far in _PADDED.items():
            number = planes if name in ("normal", "offset", "plane_grip") else cuboids
            values[name] = torch.cat([_padded(getattr(one, name), number, far) for one in each])
        values["first"] = torch.cat([one.first + start for one, start in zip(each, begin.tolist(), strict=False)])
        return cls(**values, inner=any(one.inner for one in each))

    def to(self, device: torch.device | str, **how: Any) -> Surfaces:
        """Return the same on another device; further arguments as of `Tensor.to`."""
        turn = self.turn and tuple(tensor.to(device, **how) for tensor in self.turn)
        moved = {name: getattr(self, name).to(device, **how) for name in _TENSORS}
        return replace(self, **moved, turn=cast(Any, turn))

    def in_precision(self, dtype: torch.dtype) -> Surfaces:
        """Return the same with its numbers in another precision; this very object if they are in it."""
        if self.normal.dtype == dtype:
            return self
        tensors = {name: getattr(self, name) for name in _TENSORS}
        changed = {name: tensor.to(dtype) for name, tensor in tensors.items() if tensor.is_floating_point()}
        turn = self.turn and (self.turn[0].to(dtype), self.turn[1].to(dtype), self.turn[2])
        return replace(self, **changed, turn=turn)

    def turned(self, sign: Tensor, offset: Tensor, order: Tensor) -> Surfaces:
        """Return the surfaces of scenes that are mirrored and turned; arguments as `turn`, of ones that are not yet."""
        return replace(self, turn=(sign, offset, order))

    def fields(self, position: Tensor, batch: Tensor, radius: float) -> SurfaceFields:
        """Return what particles know of the surfaces around them.

        Args:
            position: [N, D] [m].
            batch: scene of every particle [N].
            radius: within which surfaces are seen, R [m].
        """
        place = self._back(position, batch)
        if compiles(place, self.normal):
            seen, below = see(*self._in_loops(place, batch), np.float32(radius), *self._arrays(*_OF_LOOPS))
            approach, held = (self._there(each, batch) for each in torch.from_numpy(seen).unbind(1))
            return SurfaceFields(approach, held, torch.from_numpy(below))
        distance, normal, grip, ground = self._around(place, batch)
        weight = (1 - distance / radius).clamp(0, DEEPEST)
        approach = (weight[..., None] * normal).sum(dim=1)
        held = ((weight * grip)[..., None] * normal).sum(dim=1)
        return SurfaceFields(self._there(approach, batch), self._there(held, batch), ground)

    def contacts(
        self, velocity: Tensor, position: Tensor, batch: Tensor, *, radius: float, touching: float, ahead: float
    ) -> Tensor:
        """Return what the surfaces add to velocities, Σ c j [N, D] [m/s].

        j is what a surface adds to the velocity of a particle that would otherwise reach it, by Coulomb's law: all of
        the normal part, and of the sliding no more than μ times as much. c falls from 1 where it touches to 0 at the
        radius. On curved ground the velocity is turned into the tangent half a step ahead, which presses by v² / r.

        Args:
            velocity: that particles would have without them [N, D] [m/s]; the way ahead has no derivative.
            position: [N, D] [m].
            batch: scene of every particle [N].
            radius: of `fields`, R [m].
            touching: distance at which a particle touches a surface, half its spacing [m].
            ahead: half the time of a step [s].
        """
        speed, place = self._without_turn(velocity, batch), self._back(position, batch)
        if compiles(place, self.normal) and compiles(speed, backward=True):
            numbers = (np.float32(ahead), np.float32(radius), np.float32(touching))
            rest = (*numbers, *self._arrays(*_OF_LOOPS))
            return self._there(contacts_in_loops(speed, *self._in_loops(place, batch), rest), batch)
        distance, normal, grip, _ = self._around(place, batch)
        soon = normal + self._turned_ahead(place.detach(), ahead * speed.detach(), batch, normal.detach())
        share = ((radius - distance) / (radius - touching)).clamp(0, 1)
        return self._there((share[..., None] * coulomb(speed[:, None], normal, soon, grip)).sum(dim=1), batch)

    def _turned_ahead(self, place: Tensor, way: Tensor, batch: Tensor, normal: Tensor) -> Tensor:
        """Return by how much normals [N, S, D] change over a way [N, D] [m]."""
        if compiles(place, self.normal):
            tables = self._arrays(*_OF_LOOPS)
            return torch.from_numpy(normals_of(*self._in_loops(place + way, batch), *tables)) - normal
        return self._around(place + way, batch)[1] - normal

    def _around(self, place: Tensor, batch: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return distances [N, S] [m], normals [N, S, D] and grip [N or 1, S] of all surfaces, and the height below."""
        own = self._own(batch)
        distances, normals, ground = self._planes(place, own)
        distance, normal, top = self._cuboids(place, own)
        height, up_distance, up = self._ground(place, own)
        grip = torch.cat([self.plane_grip[own], self.cuboid_grip[own], self.ground_grip[own][..., None]], dim=-1)
        normals = torch.cat([normals.expand(len(place), -1, -1), normal, up[:, None]], dim=1)
        distances = torch.cat([distances, distance, up_distance[:, None]], dim=1)
        return distances, normals, grip, torch.stack([ground, top, height]).amax(dim=0)

    def keep_out(self, position: Tensor, batch: Tensor) -> Tensor:
        """Return positions of which those inside something rigid are put onto its surface [N, D] [m].

        Args:
            position: [N, D] [m].
            batch: scene of every particle [N].
        """
        if not self.inner:
            return position
        own, place = self._own(batch), self._back(position, batch)
        if self.turn is None and compiles(place, self.normal):
            place = place.clone(memory_format=torch.contiguous_format)
            push_out(place.numpy(), batch.numpy(), *self._arrays("normal", "offset", "lower", "upper", *_OF_GROUND))
            return place
        distance, normal, _ = self._planes(place, own)
        place = place + ((-distance).clamp_min(0)[..., None] * normal).sum(dim=1)
        distance, normal, _ = self._cuboids(place, own)
        place = place + ((-distance).clamp_min(0)[..., None] * normal).sum(dim=1)
        _, distance, up = self._ground(place, own)
        place = place + (-distance).clamp_min(0)[:, None] * up
        if self.turn is not None:
            sign, offset, order = (tensor[own] for tensor in self.turn)
            return (sign * place + offset).gather(-1, order.expand_as(place))
        return place

    @staticmethod
    def _in_loops(place: Tensor, batch: Tensor) -> tuple[Any, Any]:
        return place.contiguous().numpy(), batch.numpy()

    def _arrays(self, *names: str) -> list[Any]:
        return [getattr(self, name).contiguous().numpy() for name in names]

    def _own(self, batch: Tensor) -> Tensor | slice:
        """Return what picks every particle's scene; of a single one its row alone, not N copies of it."""
        return slice(0, 1) if len(self.cell) == 1 else batch

    def _back(self, position: Tensor, batch: Tensor) -> Tensor:
        """Return where particles were before their scenes were turned [N, D] [m]."""
        if self.turn is None:
            return position
        sign, offset, _ = (tensor[self._own(batch)] for tensor in self.turn)
        return self._without_turn(position, batch) - sign * offset

    def _without_turn(self, vector: Tensor, batch: Tensor) -> Tensor:
        """Return vectors as they were before their scenes were turned [N, D]."""
        if self.turn is None:
            return vector
        sign, _, order = (tensor[self._own(batch)] for tensor in self.turn)
        return sign * torch.zeros_like(vector).scatter(-1, order.expand_as(vector), vector)

    def _there(self, vector: Tensor, batch: Tensor) -> Tensor:
        """Return vectors after their scenes were turned [N, D]."""
        if self.turn is None:
            return vector
        sign, _, order = (tensor[self._own(batch)] for tensor in self.turn)
        return (sign * vector).gather(-1, order.expand_as(vector))

    def _planes(self, place: Tensor, own: Tensor | slice) -> tuple[Tensor, Tensor, Tensor]:
        """Return distances [N, P] [m], normals [N or 1, P, D], and height of the highest plane below [N] [m]."""
        normal, offset = self.normal[own], self.offset[own]
        along = (place[:, None] * normal).sum(dim=2)
        upward = normal[..., -1]
        flat = upward > FLATTEST
        rise = (along - place[:, None, -1] * upward - offset) / torch.where(flat, upward, 1.0)
        heights = torch.where(flat, -rise, -torch.inf)
        return along - offset, normal, heights.amax(dim=1)

    def _cuboids(self, place: Tensor, own: Tensor | slice) -> tuple[Tensor, Tensor, Tensor]:
        """Return distances [N, C] [m], normals [N, C, D], and height of the highest cuboid below [N] [m]."""
        below, above = self.lower[own] - place[:, None], place[:, None] - self.upper[own]
        beyond = torch.maximum(below, above)
        side = torch.where(below > above, -1.0, 1.0).to(beyond)
        outside = beyond.clamp_min(0)
        square = outside.square().sum(dim=2)
        inside = square == 0
        distance = torch.where(inside, 1.0, square).sqrt()
        deepest = torch.nn.functional.one_hot(beyond.argmax(dim=2), beyond.shape[2]).to(beyond)
        normal = side * torch.where(inside[..., None], deepest, outside / distance[..., None])
        over = (beyond[..., :-1].amax(dim=2) <= 0) & (above[..., -1] >= 0)
        top = torch.where(over, self.upper[own][..., -1], -torch.inf)
        lowest = place.new_full((len(place), 1), -torch.inf)  # where there is no cuboid at all
        return torch.where(inside, beyond.amax(dim=2), distance), normal, torch.cat([top, lowest], dim=1).amax(dim=1)

    def _ground(self, place: Tensor, own: Tensor | slice) -> tuple[Tensor, Tensor, Tensor]:
        """Return height of the ground [N] [m], distance from its tangent plane [N] [m] and normal [N, D]."""
        axes, cell, shape = place.shape[1] - 1, self.cell[own], self.shape[own]
        along = (place[:, :axes] - self.corner[own]) / cell[..., None]
        base = torch.minimum((along - 0.5).clamp_min(0).floor(), (shape - 3).to(along))
        part = along - base - 1
        inside = part.clamp(-0.5, 0.5)
        low, high = 0.5 - inside, 0.5 + inside
        weights = torch.stack([0.5 * low.square(), 0.75 - inside.square(), 0.5 * high.square()], dim=2)
        slopes = torch.stack([-low, -2 * inside, high], dim=2)
        node = base.long()[..., None] + torch.arange(3, device=place.device)
        if axes == 1:
            index = self.first[own][..., None] + node[:, 0]
        else:
            row = self.first[own][..., None] + node[:, 0] * shape[..., 1, None]
            index = row[..., None] + node[:, 1, None]
        heights = self.heights[index]
        if axes == 1:
            height, rise = (weights[:, 0] * heights).sum(1), (slopes[:, 0] * heights).sum(1)[:, None]
        else:
            rows, row_rises = (weights[:, 1, None] * heights).sum(2), (slopes[:, 1, None] * heights).sum(2)
            height = (weights[:, 0] * rows).sum(1)
            rise = torch.stack([(slopes[:, 0] * rows).sum(1), (weights[:, 0] * row_rises).sum(1)], dim=1)
        height = height + ((part - inside) * rise).sum(dim=1)  # straight on beyond the last heights
        slope = rise / cell[..., None]
        up = torch.cat([-slope, torch.ones_like(slope[:, :1])], dim=1)
        up = up / up.norm(dim=1, keepdim=True)
        return height, (place[:, -1] - height) * up[:, -1], up


_TENSORS = tuple(entry.name for entry in fields(Surfaces) if entry.name not in ("inner", "turn"))

_OF_GROUND = ("heights", "first", "shape", "corner", "cell")
_OF_LOOPS = ("normal", "offset", "plane_grip", "lower", "upper", "cuboid_grip", *_OF_GROUND, "ground_grip")

FAR = 1e6
"""Distance of the surfaces that scenes of fewer ones are filled up with [m]."""

_PADDED = {"normal": 0.0, "offset": -FAR, "plane_grip": 0.0, "lower": FAR, "upper": 2 * FAR, "cuboid_grip": 0.0}
"""What has one entry for every plane or cuboid → the value of one that is out of reach."""


def _padded(tensor: Tensor, number: int, value: float) -> Tensor:
    """Return a tensor [1, K, …] with so many entries along its second axis, the new ones all of one value."""
    missing = tensor.new_full((1, number - tensor.shape[1], *tensor.shape[2:]), value)
    return torch.cat([tensor, missing], dim=1)
