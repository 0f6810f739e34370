"""The height of material above every particle: what pressure comes from, and what no short-sighted network can see.

Over a step of 10 ms pressure crosses a whole column, while a few message-passing steps reach a few spacings. The
thickness of the overburden, and its differences between neighbours, carry that information at the cost of a sum.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor


def overburden(position: Tensor, lower: Tensor, upper: Tensor, batch: Tensor, *, cell: float, volume: float) -> Tensor:
    """Return the thickness of solid material above every particle, averaged over about a cell [N] [m].

    The particles' volumes are spread to the nodes of a grid with multilinear weights, summed from the top down along
    the last axis, divided by the area of a cell, and interpolated back with the same weights.

    Args:
        position: [N, D] [m].
        lower: lower corner of every box [B, D] [m].
        upper: upper corner of every box [B, D] [m].
        batch: box of every particle [N].
        cell: edge of a grid cell [m].
        volume: volume of a particle [m^D].
    """
    dim = position.shape[1]
    nodes = ((upper - lower) / cell).amax(dim=0).floor().long() + 2
    place = ((position - lower[batch]) / cell).clamp(min=0.0)
    place = torch.minimum(place, (nodes - 1).to(place.dtype) - 1e-3)
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
    shape = (len(lower) * int(nodes[:-1].prod()), int(nodes[-1]))
    filled = torch.zeros(shape[0] * shape[1], dtype=position.dtype, device=position.device)
    filled = filled.index_add(0, corner_index.flatten(), weight.flatten() * volume).view(shape)
    above = filled.flip(1).cumsum(1).flip(1) - 0.5 * filled
    return (above.flatten()[corner_index] * weight).sum(dim=0) / cell ** (dim - 1)
