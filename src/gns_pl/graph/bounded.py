"""A neighbour search that leaves the GPU alone: no number is read back, so that a step can become a CUDA graph."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

LANES = 32
"""Candidates that are looked at together."""


@triton.jit
def _meet(  # type: ignore[no-untyped-def]
    position, order, begin, end, first, counts, senders, receivers, number, capacity, squared_radius,
    DIM: tl.constexpr, RUNS: tl.constexpr, LANES: tl.constexpr, FILLS: tl.constexpr,
):  # fmt: skip
    """Count a particle's neighbours among its candidates, or write them down."""
    here, lane = tl.program_id(0), tl.arange(0, LANES)
    total = tl.load(first + here) if FILLS else tl.zeros((), tl.int64)
    for run in range(RUNS):
        at, stop = tl.load(begin + run * number + here), tl.load(end + run * number + here)
        while at < stop:
            inside = at + lane < stop
            other = tl.load(order + at + lane, mask=inside, other=0)
            distance = tl.zeros((LANES,), tl.float32)
            for axis in tl.static_range(DIM):
                apart = tl.load(position + here * DIM + axis) - tl.load(position + other * DIM + axis)
                distance += apart * apart
            close = inside & (other != here) & (distance < squared_radius)
            if FILLS:
                place = total + tl.cumsum(close.to(tl.int64), axis=0) - 1
                stored = close & (place < capacity)
                tl.store(senders + place, other, mask=stored)
                tl.store(receivers + place, tl.zeros((LANES,), tl.int64) + here, mask=stored)
            total += tl.sum(close.to(tl.int64), axis=0)
            at += LANES
    if not FILLS:
        tl.store(counts + here, total)


class BoundedSearch:
    """`radius_graph` with room for a number of edges; what is left is filled with edges of the last node to itself.

    Edges come sorted by receiver; those of a receiver in the order of cells, not of senders.

    Args:
        capacity: number of edges returned.

    Attributes:
        wanted: edges that there are, on the device; more than the capacity means that some are missing.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.wanted = torch.zeros((), dtype=torch.int64)

    def __call__(
        self,
        position: Tensor,
        radius: float,
        batch: Tensor | None = None,
        *,
        backend: str = "auto",
        num_graphs: int = 1,
    ) -> Tensor:
        """Return edge_index [2, capacity]; arguments as those of `radius_graph`, with a backend of its own."""
        number, dim = position.shape
        position = position.detach().contiguous()
        cell = ((position - position.amin(dim=0)).double() / (radius * (1 + 1e-5))).floor().long() + 1
        extent = cell.amax(dim=0) + 2
        key = torch.zeros_like(cell[:, 0]) if batch is None else batch
        for axis in range(dim):
            key = key * extent[axis] + cell[:, axis]
        shifts = torch.zeros((), dtype=torch.int64, device=position.device)
        for axis in range(dim - 1):  # of the columns of cells around a particle's own, in ascending order
            shifts = (shifts[..., None] + torch.arange(-1, 2, device=position.device)) * extent[axis + 1]
        shifts = shifts.reshape(-1)
        ordered, order = torch.sort(key, stable=True)
        middle = key + shifts[:, None]
        begin = torch.searchsorted(ordered, middle - 1)
        end = torch.searchsorted(ordered, middle + 1, right=True)
        counts = torch.empty_like(key)
        edges = position.new_full((2, self.capacity), number - 1, dtype=torch.int64)
        for fills in (False, True):
            first = counts.cumsum(0) - counts if fills else counts
            _meet[(number,)](
                position, order, begin, end, first, counts, edges[0], edges[1], number, self.capacity, radius**2,
                DIM=dim, RUNS=len(shifts), LANES=LANES, FILLS=fills, num_warps=1, enable_fp_fusion=False,
            )  # fmt: skip
        self.wanted = counts.sum()
        return edges
