"""Features in compiled loops, one operation for autograd each: there in `feature_loops`, back in `feature_backward`."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from gns_pl.graph.context import EMPTY, REACH
from gns_pl.graph.feature_backward import (
    context_backward,
    edges_backward,
    material_backward,
    motion_and_walls_backward,
    sums_backward,
)
from gns_pl.graph.feature_loops import fill_context, fill_edges, fill_kinds, fill_motion_and_walls, sum_context

Array = NDArray[Any]


def edges_in_loops(position: Tensor, edge_index: Tensor, radius: float) -> Tensor:
    """Return what `edge_features` does."""
    return cast(Tensor, _EdgeFeatures.apply(position, edge_index, np.float32(radius)))  # type: ignore[no-untyped-call]


def nodes_in_loops(velocity: Tensor, position: Tensor, material: Tensor, constants: NodeConstants) -> Tensor:
    """Return what `node_features` does, of velocities [N, H − 1, D], positions [N, D] and material [N, K]."""
    return cast(Tensor, _NodeFeatures.apply(velocity, position, material, constants))  # type: ignore[no-untyped-call]


class NodeConstants(NamedTuple):
    """What node features are made of that has no derivative.

    Attributes:
        width: of the features, F.
        lower: corner of every box [B, D] [m].
        upper: likewise.
        batch: box of every particle [N].
        volume: [N] [m^D].
        particle_type: [N].
        kinds: that are told apart [K'].
        material_scale: means and deviations [2, M].
        velocity_scale: [m/s].
        radius: connectivity radius [m].
        spacing: of the particles [m].
        grid: arrays of the context's; None without context.
    """

    width: int
    lower: Array
    upper: Array
    batch: Array
    volume: Array
    particle_type: Array
    kinds: Array
    material_scale: Array
    velocity_scale: np.float32
    radius: float
    spacing: float
    grid: list[Array] | None

    def sizes(self) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
        """Return what `fill_context` wants behind the volumes."""
        cell = self.spacing ** self.lower.shape[1]
        reach, radius, empty = np.float32(REACH * self.radius), np.float32(self.radius), np.float32(EMPTY)
        return reach, radius, empty, np.float32(cell), self.velocity_scale


class _EdgeFeatures(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, position: Tensor, edge_index: Tensor, radius: np.float32) -> Tensor:
        feature = position.new_empty(edge_index.shape[1], position.shape[1] + 1)
        fill_edges(_array(position), edge_index.numpy(), radius, feature.numpy())
        ctx.save_for_backward(feature, edge_index)
        ctx.radius, ctx.shape = radius, position.shape
        return feature

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor | None, ...]:
        feature, edge_index = ctx.saved_tensors
        to_position = above.new_zeros(ctx.shape)
        edges_backward(_array(feature), edge_index.numpy(), ctx.radius, _array(above), to_position.numpy())
        return to_position, None, None


class _NodeFeatures(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, velocity: Tensor, position: Tensor, material: Tensor, constants: NodeConstants) -> Tensor:
        feature = position.new_empty(len(position), constants.width)
        speeds, place, columns = _array(velocity), _array(position), feature.numpy()
        lower, batch, volume = constants.lower, constants.batch, constants.volume
        settings = constants.velocity_scale, place, lower, constants.upper, batch, np.float32(constants.radius)
        begin = fill_motion_and_walls(speeds, *settings, columns)
        ctx.summed = ()
        if constants.grid is not None:
            latest = np.ascontiguousarray(speeds[:, -1])
            ctx.summed = sum_context(place, latest, batch, volume, *constants.grid)
            fill_context(ctx.summed[0], place, lower, batch, volume, *constants.sizes(), begin, columns)
            begin += 4 + position.shape[1]
        fill_kinds(constants.particle_type, constants.kinds, _array(material), constants.material_scale, begin, columns)
        ctx.save_for_backward(velocity, position)
        ctx.constants, ctx.of_material = constants, material.shape
        return feature

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor | None, ...]:
        velocity, position = ctx.saved_tensors
        constants: NodeConstants = ctx.constants
        to_velocity, to_position = (
            torch.zeros_like(given, memory_format=torch.contiguous_format) for given in (velocity, position)
        )
        to_material = above.new_zeros(ctx.of_material) if ctx.needs_input_grad[2] else None
        columns, place = _array(above), _array(position)
        lower, batch, volume = constants.lower, constants.batch, constants.volume
        settings = constants.velocity_scale, place, lower, constants.upper, batch, np.float32(constants.radius)
        by_position, by_velocity = to_position.numpy(), to_velocity.numpy()
        begin = motion_and_walls_backward(columns, *settings, by_velocity, by_position)
        if constants.grid is not None:
            context, nodal, corner, weight = ctx.summed
            given = context_backward(
                columns, context, place, lower, batch, volume, *constants.sizes(), begin, by_position
            )
            latest, by_latest = (np.ascontiguousarray(each[:, -1]) for each in (_array(velocity), by_velocity))
            rest = [*constants.grid, by_position, by_latest]
            sums_backward(given, nodal, corner, weight, place, latest, batch, volume, *rest)
            by_velocity[:, -1] = by_latest
            begin += 4 + position.shape[1]
        if to_material is not None:
            material_backward(columns, constants.material_scale, begin + len(constants.kinds), to_material.numpy())
        return to_velocity, to_position, to_material, None


def _array(tensor: Tensor) -> Array:
    array: Array = tensor.detach().contiguous().numpy()
    return array
