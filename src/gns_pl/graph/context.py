"""What a particle cannot see through a few message-passing steps: what lies above and below, and how densely.

Over a step of 10 ms pressure crosses a whole column, while a few message-passing steps reach a few spacings. The
thickness of the overburden, and its differences between neighbours, carry that information at the cost of a sum; so
does the overburden's momentum, which what lies below has to stop. The empty height below tells a body in the air from
one that stands, and when it will land, whatever its size. The solid fraction is the mean over a few dozen particles,
which tells a sunken heap from a sound one where the irregular places of the nearest neighbours do not.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from gns_pl.errors import InputError

DENSE_NODES = 2**20
"""A box of at most so many nodes has an array of all of them; of a larger one only the nodes at particles are kept."""


REACH = 4.0
"""The distance to the floor is cut at this many connectivity radii where context is wanted. Only the floor's: a far
side wall would be one more thing that a narrower or wider box than those of the data shows in a new way."""

EMPTY = 2.0
"""The empty height below is cut at this many connectivity radii; a body higher up falls freely for some steps."""

DENSE_BYTES, SPARSE_BYTES = {2: 88, 3: 112}, {2: 330, 3: 400}
"""D → bytes for every node of a box; and, of larger boxes, for every node of every particle."""


@dataclass(frozen=True)
class ContextGrid:
    """The grid that material is spread to; all boxes of a batch have as many nodes as the largest needs.

    Memory for every node of a box is taken only where these are few. In a field of 100 m with cells of some centimetres
    they would be thousands of millions, of which particles reach a few thousand; there the nodes that particles reach
    are found by sorting, which gives the same numbers (up to the rounding of sums). Exported programs
    have the first way alone.

    Attributes:
        shape: nodes of every axis.
        lower: lower corner of every box [B, D] [m].
        cells: cells of every box [B, D].
        edge: of the cells of every box [B, D] [m].
        room: part of every node's cell that lies in its box [columns of nodes, nodes of a column, 1] [m^D]; None where
            only the nodes at particles are kept.
        height: its extent along the last axis, alike [m].
    """

    shape: tuple[int, ...]
    lower: Tensor
    cells: Tensor
    edge: Tensor
    room: Tensor | None
    height: Tensor | None

    @functools.cached_property
    def arrays(self) -> list[NDArray[Any]] | None:
        """Of boxes whose nodes all are kept: what `graph.feature_loops` wants of the grid."""
        if self.room is None or self.height is None:
            return None
        tensors = (self.lower, self.edge, self.cells, torch.tensor(self.shape), self.room, self.height)
        return [tensor.contiguous().numpy() for tensor in tensors]

    @classmethod
    def of(cls, lower: Tensor, upper: Tensor, cell: float) -> ContextGrid:
        """Build the grid of boxes.

        Args:
            lower: lower corner of every box [B, D] [m].
            upper: upper corner of every box [B, D] [m].
            cell: wanted edge of a grid cell [m]; each axis of each box takes the nearest size that divides it.

        Raises:
            InputError: so many cells that they cannot be numbered.
        """
        boxes, dim = lower.shape
        cells = ((upper - lower) / cell).round().clamp(min=1.0)
        edge = (upper - lower) / cells
        most, exporting = cells.amax(dim=0), torch.compiler.is_exporting()
        shape = grid_shape((most.long() if exporting else most).tolist())
        if not exporting and math.prod(shape) > DENSE_NODES:
            if boxes * math.prod(shape) > torch.iinfo(torch.int64).max:
                raise InputError(
                    f"a box of {(upper - lower).amax():.3g} m has too many cells of the radius, {cell:g} m; "
                    "check the unit of length, or set a larger model.connectivity_radius."
                )
            return cls(shape, lower, cells, edge, None, None)
        room = torch.ones((), dtype=lower.dtype, device=lower.device)
        for axis in range(dim):
            node = torch.arange(shape[axis], device=lower.device)
            face = (node == 0) | (node == cells[:, axis, None])  # half of a node's cell lies outside
            extent = edge[:, axis, None] * torch.where(face, 0.5, 1.0).to(lower.dtype)
            extent = extent.view(boxes, *[-1 if other == axis else 1 for other in range(dim)])
            room = room * extent
        flat = (boxes * math.prod(shape[:-1]), shape[-1], 1)
        room, height = (values.expand(boxes, *shape).reshape(flat) for values in (room, extent))
        return cls(shape, lower, cells, edge, room, height)


def grid_shape(cells: Sequence[float]) -> tuple[int, ...]:
    """Return the nodes of every axis of a grid with so many cells."""
    return tuple(int(cell) + 1 for cell in cells)


def context_bytes(nodes: int, boxes: int, num_particles: int, dim: int, *, compiled: bool) -> int:
    """Return the most bytes that `context_fields` holds at once in float32, and the grid itself.

    Args:
        nodes: of a box.
        boxes: B.
        num_particles: N, of all boxes.
        dim: D.
        compiled: by the loops of `graph.feature_loops`, on a CPU; only where the nodes of a box are few.
    """
    if compiled and nodes <= DENSE_NODES:
        return num_particles * (12 * (1 << dim) + 4 * (dim + 4)) + 4 * (dim + 5) * boxes * nodes
    corners = (1 << dim) * num_particles * (8 + 4 * (2 + dim) + 8 * (dim + 3))
    if nodes <= DENSE_NODES:
        return corners + DENSE_BYTES[dim] * boxes * nodes
    return corners + SPARSE_BYTES[dim] * (1 << dim) * num_particles


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
    corner_index, weight, over = nodes_around(position, grid, batch)
    moments = volume[:, None] * torch.cat([torch.ones_like(velocity[:, :1]), velocity], dim=1)
    spread = (weight * moments).flatten(0, 1)
    if grid.room is None or grid.height is None:
        nodal, corner_index = _sparse_sums(grid, spread, corner_index)
    else:
        nodal = _dense_sums(grid.room, grid.height, spread, corner_index)
    # index_select, as the gradient of plain indexing is slow on a CPU.
    gathered = nodal.index_select(0, corner_index).view(len(weight), number, dim + 3)
    values = (gathered * weight).sum(dim=0)
    empty = over[:, -1] - values[:, -2]
    return values[:, 0], values[:, 1:-2], empty, values[:, -1]


def nodes_around(position: Tensor, grid: ContextGrid, batch: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the nodes around particles [2^D N], their multilinear weights [2^D, N, 1], and places in the box [N, D].

    Args:
        position: [N, D] [m].
        grid: of the boxes.
        batch: box of every particle [N].
    """
    dim = position.shape[1]
    own = 0 if len(grid.lower) == 1 else batch  # of one box its row alone is taken, not N copies of it
    lower, edge, cells = grid.lower[own], grid.edge[own], grid.cells[own]
    place = torch.minimum(((position - lower) / edge).clamp(min=0.0), cells - 1e-3)
    base = torch.minimum(place.floor(), cells - 1)  # of many thousand cells 1e-3 is less than a float32 can tell
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
    return torch.cat(corners), torch.stack(weights)[:, :, None], place * edge


def _dense_sums(room: Tensor, height: Tensor, spread: Tensor, corner_index: Tensor) -> Tensor:
    """Return thickness and momentum above, thickness below and solid fraction of every node of all boxes [G, D + 3].

    Args:
        room: of a `ContextGrid`.
        height: of a `ContextGrid`.
        spread: volume and its momentum that particles give to their nodes [M, 1 + D] [m^D].
        corner_index: the node [M].
    """
    layers, width = room.shape[:2], spread.shape[1]
    filled = torch.zeros(layers[0] * layers[1], width, dtype=spread.dtype, device=spread.device)
    filled = filled.index_add(0, corner_index, spread).view(*layers, width)
    dense = filled / room
    layer = dense * height
    below = layer.cumsum(1) - 0.5 * layer
    below[:, 0] = 0.0
    above = layer.sum(dim=1, keepdim=True) - below
    return torch.cat([above, below[..., :1], dense[..., :1]], dim=2).flatten(0, 1)


def _sparse_sums(grid: ContextGrid, spread: Tensor, corner_index: Tensor) -> tuple[Tensor, Tensor]:
    """Return what `_dense_sums` does, of the nodes that particles reach alone, and the rows of these in the result [M].

    The nodes are sorted, so that those of a column stand together, the lowest first. Their number is not read back from
    the device: arrays have a row for every part that is spread, of which the last ones stay empty.

    Args:
        grid: whose nodes are too many for an array of all.
        spread: as of `_dense_sums`.
        corner_index: as of `_dense_sums`.
    """
    number = len(corner_index)
    ordered, order = torch.sort(corner_index, stable=True)
    begins = torch.cat([ordered.new_ones(1, dtype=torch.bool), ordered[1:] != ordered[:-1]])
    row = torch.empty_like(order).index_copy(0, order, begins.cumsum(0) - 1)
    node = torch.zeros_like(ordered).index_copy(0, row, corner_index)
    used = torch.arange(number, device=row.device) <= row.amax()
    place, rest = [], node
    for length in reversed(grid.shape):
        place.append(rest % length)
        rest = rest // length
    box, index = rest, torch.stack(place[::-1], dim=1)
    face = (index == 0) | (index == grid.cells[box])  # half of a node's cell lies outside
    extent = grid.edge[box] * torch.where(face, 0.5, 1.0).to(spread.dtype)
    filled = torch.zeros_like(spread).index_add(0, row, spread)
    dense = filled / extent.prod(dim=1, keepdim=True)
    layer = dense * extent[:, -1:]
    # One running sum over all columns; in float64, as what came before a column is taken off again.
    total = layer.double().cumsum(0)
    column = torch.where(used, node // grid.shape[-1], -1)
    opens = torch.cat([used.new_ones(1), column[1:] != column[:-1]])
    first = torch.where(opens, torch.arange(number, device=row.device), 0).cummax(0).values
    closes = torch.cat([opens[1:], used.new_ones(1)])
    last = torch.where(closes, torch.arange(number, device=row.device), number - 1).flip(0).cummin(0).values.flip(0)
    before = total.index_select(0, first) - layer.index_select(0, first).double()
    below = total - before - 0.5 * layer
    below = torch.where(index[:, -1:] == 0, 0.0, below)
    above = total.index_select(0, last) - before - below
    return torch.cat([above, below[:, :1], dense[:, :1]], dim=1).to(spread.dtype), row
