"""What a particle cannot see through a few message-passing steps: what lies above and below, and how densely.

Over a step of 10 ms pressure crosses a whole column, while a few message-passing steps reach a few spacings. The
thickness of the overburden, and its differences between neighbours, carry that information at the cost of a sum; so
does the overburden's momentum, which what lies below has to stop. The empty height below tells a body in the air from
one that stands, and when it will land, whatever its size. The solid fraction is the mean over a few dozen particles,
which tells a sunken heap from a sound one where the irregular places of the nearest neighbours do not.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class ContextGrid:
    """The grid that material is spread to; all boxes of a batch have as many nodes as the largest needs.

    Attributes:
        shape: nodes of every axis.
        lower: lower corner of every box [B, D] [m].
        cells: cells of every box [B, D].
        edge: of the cells of every box [B, D] [m].
        room: part of every node's cell that lies in its box [columns of nodes, nodes of a column, 1] [m^D].
        height: its extent along the last axis, alike [m].
    """

    shape: tuple[int, ...]
    lower: Tensor
    cells: Tensor
    edge: Tensor
    room: Tensor
    height: Tensor

    @classmethod
    def of(cls, lower: Tensor, upper: Tensor, cell: float) -> ContextGrid:
        """Build the grid of boxes.

        Args:
            lower: lower corner of every box [B, D] [m].
            upper: upper corner of every box [B, D] [m].
            cell: wanted edge of a grid cell [m]; each axis of each box takes the nearest size that divides it.
        """
        boxes, dim = lower.shape
        cells = ((upper - lower) / cell).round().clamp(min=1.0)
        edge = (upper - lower) / cells
        shape = tuple(int(most) + 1 for most in cells.amax(dim=0))
        room = torch.ones((), dtype=lower.dtype, device=lower.device)
        for axis in range(dim):
            node = torch.arange(shape[axis], device=lower.device)
            face = (node == 0) | (node == cells[:, axis, None])  # half of a node's cell lies outside
            extent = edge[:, axis, None] * torch.where(face, 0.5, 1.0).to(lower.dtype)
            extent = extent.view(boxes, *[-1 if other == axis else 1 for other in range(dim)])
            room = room * extent
        flat = (boxes * math.prod(shape[:-1]), shape[-1], 1)
        room, height = (each.expand(boxes, *shape).reshape(flat) for each in (room, extent))
        return cls(shape, lower, cells, edge, room, height)


def context_fields(
    position: Tensor, velocity: Tensor, grid: ContextGrid, batch: Tensor, *, volume: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return thickness and momentum of the material above every particle, empty height below, solid fraction around.

    The particles' volumes, and these times their velocities, are spread to the nodes of a grid with multilinear
    weights. Divided by the part of each node's cell that lies in the box they give the solid fraction (and a density of
    momentum), and that times the heights of the cells, summed along the last axis, thicknesses: a node's own cell
    counts half to what lies above it, half below; on the floor all above. All are interpolated back with the same
    weights. The empty height is that of the particle over the floor less the thickness below.

    Nothing here waits for a GPU.

    Args:
        position: [N, D] [m].
        velocity: [N, D] [m/s].
        grid: of the boxes.
        batch: box of every particle [N].
        volume: volume that every particle stands for [N] [m^D].

    Returns:
        Thickness above [N] [m]; the velocity integrated over it [N, D] [m²/s]; empty height below [N] [m], near zero
        where material rests on the floor; all averaged over about a cell; and solid fraction [N], 1 where nothing is
        squeezed or opened.
    """
    number, dim = position.shape
    boxes = len(grid.lower)
    own = 0 if boxes == 1 else batch  # of one box its row alone is taken, not N copies of it
    lower, edge, cells = grid.lower[own], grid.edge[own], grid.cells[own]
    place = torch.minimum(((position - lower) / edge).clamp(min=0.0), cells - 1e-3)
    base = place.floor()
    fraction = place - base
    parts = ((1 - fraction).unbind(1), fraction.unbind(1))
    stride = [math.prod(grid.shape[axis + 1 :]) for axis in range(dim)]
    first = batch * math.prod(grid.shape)
    for axis in range(dim):
        first = first + base[:, axis].long() * stride[axis]
    corners, weights = [], []
    for corner in itertools.product((0, 1), repeat=dim):
        weights.append(torch.stack([parts[side][axis] for axis, side in enumerate(corner)]).prod(dim=0))
        corners.append(first + sum(side * step for side, step in zip(corner, stride, strict=True)))
    corner_index, weight = torch.cat(corners), torch.stack(weights)[:, :, None]
    carried = volume[:, None] * torch.cat([torch.ones_like(velocity[:, :1]), velocity], dim=1)
    layers = grid.room.shape[:2]
    filled = torch.zeros(layers[0] * layers[1], 1 + dim, dtype=position.dtype, device=position.device)
    filled = filled.index_add(0, corner_index, (weight * carried).flatten(0, 1)).view(*layers, 1 + dim)
    dense = filled / grid.room
    layer = dense * grid.height
    below = layer.cumsum(1) - 0.5 * layer
    below[:, 0] = 0.0
    above = layer.sum(dim=1, keepdim=True) - below
    nodal = torch.cat([above, below[..., :1], dense[..., :1]], dim=2).flatten(0, 1)
    # index_select, as the gradient of plain indexing is slow on a CPU.
    gathered = nodal.index_select(0, corner_index).view(len(weight), number, dim + 3)
    values = (gathered * weight).sum(dim=0)
    empty = place[:, -1] * edge[..., -1] - values[:, -2]
    return values[:, 0], values[:, 1:-2], empty, values[:, -1]
