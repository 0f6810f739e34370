"""What a particle cannot see through a few message-passing steps: the material above it, and how dense it lies.

Over a step of 10 ms pressure crosses a whole column, while a few message-passing steps reach a few spacings. The
thickness of the overburden, and its differences between neighbours, carry that information at the cost of a sum. The
solid fraction is the mean over a few dozen particles, which tells a sunken heap from a sound one where the irregular
places of the nearest neighbours do not.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor


def context_fields(
    position: Tensor, lower: Tensor, upper: Tensor, batch: Tensor, *, cell: float, volume: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the thickness of material above every particle, and the solid fraction around it.

    The particles' volumes are spread to the nodes of a grid with multilinear weights. Summed from the top down along
    the last axis and divided by the area of a cell they give the thickness, divided by the part of each node's cell
    that lies in the box the fraction; both are interpolated back with the same weights.

    Args:
        position: [N, D] [m].
        lower: lower corner of every box [B, D] [m].
        upper: upper corner of every box [B, D] [m].
        batch: box of every particle [N].
        cell: wanted edge of a grid cell [m]; each axis of each box takes the nearest size that divides it.
        volume: volume that every particle stands for [N] [m^D].

    Returns:
        Thickness [N] [m], averaged over about a cell, and solid fraction [N], 1 where nothing is squeezed or opened.
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
    above = filled.flip(1).cumsum(1).flip(1) - 0.5 * filled
    room = edge.prod(dim=1).view(boxes, *(1,) * dim)
    for axis in range(dim):
        node = torch.arange(int(nodes[axis]), device=position.device)
        face = (node == 0) | (node == cells[:, axis, None])  # half of a node's cell lies outside
        share = torch.where(face, 0.5, 1.0).to(position.dtype)
        room = room * share.view(boxes, *[-1 if other == axis else 1 for other in range(dim)])
    dense = filled / room.reshape(shape)
    area = edge[:, :-1].prod(dim=1)[batch]
    thickness = (above.flatten()[corner_index] * weight).sum(dim=0) / area
    return thickness, (dense.flatten()[corner_index] * weight).sum(dim=0)
