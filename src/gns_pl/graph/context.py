"""What a particle cannot see through a few message-passing steps: what lies above and below, and how densely.

Over a step of 10 ms pressure crosses a whole column, while a few message-passing steps reach a few spacings. The
thickness of the overburden, and its differences between neighbours, carry that information at the cost of a sum. The
empty height below tells a body in the air from one that stands, and when it will land, whatever its size. The
solid fraction is the mean over a few dozen particles, which tells a sunken heap from a sound one where the irregular
places of the nearest neighbours do not.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor


def context_fields(
    position: Tensor, lower: Tensor, upper: Tensor, batch: Tensor, *, cell: float, volume: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the thickness of material above every particle, the empty height below, and the solid fraction around.

    The particles' volumes are spread to the nodes of a grid with multilinear weights. Divided by the part of each
    node's cell that lies in the box they give the solid fraction, and that times the heights of the cells, summed along
    the last axis, thicknesses: a node's own cell counts half to what lies above it, half below; on the floor all above.
    All are interpolated back with the same weights. The empty height is that of the particle over the floor less the
    thickness below.

    Args:
        position: [N, D] [m].
        lower: lower corner of every box [B, D] [m].
        upper: upper corner of every box [B, D] [m].
        batch: box of every particle [N].
        cell: wanted edge of a grid cell [m]; each axis of each box takes the nearest size that divides it.
        volume: volume that every particle stands for [N] [m^D].

    Returns:
        Thickness above [N] [m] and empty height below [N] [m], averaged over about a cell, the latter near zero where
        material rests on the floor; and solid fraction [N], 1 where nothing is squeezed or opened.
    """
    dim = position.shape[1]
    cells = ((upper - lower) / cell).round().clamp(min=1.0)
    edge = (upper - lower) / cells
    nodes = cells.amax(dim=0).long() + 1
    place = ((position - lower[batch]) / edge[batch]).clamp(min=0.0)
    place = torch.minimum(place, cells[batch] - 1e-3)
    base = place.floor()
    fraction = place - base
    corners, weights = [], []
    for corner in itertools.product((0, 1), repeat=dim):
        offset = torch.tensor(corner, device=position.device)
        weights.append(torch.where(offset.bool(), fraction, 1 - fraction).prod(dim=1))
        index = batch
        for axis in range(dim):
            index = index * nodes[axis] + base[:, axis].long() + offset[axis]
        corners.append(index)
    corner_index, weight = torch.stack(corners), torch.stack(weights)
    boxes = len(lower)
    shape = (boxes * int(nodes[:-1].prod()), int(nodes[-1]))
    filled = torch.zeros(shape[0] * shape[1], dtype=position.dtype, device=position.device)
    filled = filled.index_add(0, corner_index.flatten(), (weight * volume).flatten()).view(shape)
    room = torch.ones((), dtype=position.dtype, device=position.device)
    for axis in range(dim):
        node = torch.arange(int(nodes[axis]), device=position.device)
        face = (node == 0) | (node == cells[:, axis, None])  # half of a node's cell lies outside
        extent = edge[:, axis, None] * torch.where(face, 0.5, 1.0).to(position.dtype)
        extent = extent.view(boxes, *[-1 if other == axis else 1 for other in range(dim)])
        room = room * extent
    dense = filled / room.expand(boxes, *nodes.tolist()).reshape(shape)
    layer = dense * extent.expand(boxes, *nodes.tolist()).reshape(shape)  # of the last axis
    below = layer.cumsum(1) - 0.5 * layer
    below[:, 0] = 0.0
    above = layer.sum(dim=1, keepdim=True) - below

    def at_particles(nodal: Tensor) -> Tensor:
        return (nodal.flatten()[corner_index] * weight).sum(dim=0)

    empty = place[:, -1] * edge[batch, -1] - at_particles(below)
    return at_particles(above), empty, at_particles(dense)
