"""What a particle cannot see through a few message-passing steps: what lies above and below, and how densely.

Over a step of 10 ms pressure crosses a whole column, while a few message-passing steps reach a few spacings. The
thickness of the overburden, and its differences between neighbours, carry that information at the cost of a sum; so
does the overburden's momentum, which what lies below has to stop. The empty height below tells a body in the air from
one that stands, and when it will land, whatever its size. The solid fraction is the mean over a few dozen particles,
which tells a sunken heap from a sound one where the irregular places of the nearest neighbours do not.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor


def context_fields(
    position: Tensor, velocity: Tensor, lower: Tensor, upper: Tensor, batch: Tensor, *, cell: float, volume: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return thickness and momentum of the material above every particle, empty height below, solid fraction around.

    The particles' volumes, and these times their velocities, are spread to the nodes of a grid with multilinear
    weights. Divided by the part of each node's cell that lies in the box they give the solid fraction (and a density of
    momentum), and that times the heights of the cells, summed along the last axis, thicknesses: a node's own cell
    counts half to what lies above it, half below; on the floor all above. All are interpolated back with the same
    weights. The empty height is that of the particle over the floor less the thickness below.

    Args:
        position: [N, D] [m].
        velocity: [N, D] [m/s].
        lower: lower corner of every box [B, D] [m].
        upper: upper corner of every box [B, D] [m].
        batch: box of every particle [N].
        cell: wanted edge of a grid cell [m]; each axis of each box takes the nearest size that divides it.
        volume: volume that every particle stands for [N] [m^D].

    Returns:
        Thickness above [N] [m]; the velocity integrated over it [N, D] [m²/s]; empty height below [N] [m], near zero
        where material rests on the floor; all averaged over about a cell; and solid fraction [N], 1 where nothing is
        squeezed or opened.
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
    corner_index, weight = torch.cat(corners), torch.stack(weights)[:, :, None]
    boxes = len(lower)
    shape = (boxes * int(nodes[:-1].prod()), int(nodes[-1]), 1)
    carried = volume[:, None] * torch.cat([torch.ones_like(velocity[:, :1]), velocity], dim=1)
    filled = torch.zeros(shape[0] * shape[1], 1 + dim, dtype=position.dtype, device=position.device)
    filled = filled.index_add(0, corner_index, (weight * carried).flatten(0, 1)).view(*shape[:2], 1 + dim)
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
    nodal = torch.cat([above, below[..., :1], dense[..., :1]], dim=2).flatten(0, 1)
    # index_select, as the gradient of plain indexing is slow on a CPU.
    gathered = nodal.index_select(0, corner_index).view(len(weight), len(position), dim + 3)
    own = (gathered * weight).sum(dim=0)
    empty = place[:, -1] * edge[batch, -1] - own[:, -2]
    return own[:, 0], own[:, 1:-2], empty, own[:, -1]
