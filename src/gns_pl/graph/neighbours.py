"""Exact radius graphs: every pair closer than the radius, no cap on the number of neighbours.

Each backend proposes candidate pairs; one common filter (float32, |x_i − x_j|² < R²) decides, so that all of them
return the same edges to the last bit. `brute_force` is the oracle of the tests.
"""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.graph.cells import all_finite, neighbours

_MARGIN = 1.0 + 1e-5
"""Candidates are searched a little beyond the radius, so that rounding never loses a pair to the filter."""


def radius_graph(
    position: Tensor, radius: float, batch: Tensor | None = None, *, backend: str = "auto", num_graphs: int = 1
) -> Tensor:
    """Return the directed edges between all particles of one graph closer than `radius`, both ways, no self-loops.

    Args:
        position: [N, D] [m].
        radius: connectivity radius R [m].
        batch: [N] graph of every particle, ascending; all in one graph if None.
        backend: a key of `BACKENDS`, or "auto": "cell_list" on CUDA, "numba" elsewhere.
        num_graphs: B, the number of graphs in `batch`.

    Returns:
        edge_index [2, E]: sender j, receiver i; sorted by receiver, then by sender.

    Raises:
        InputError: an unknown backend, a radius that is not positive, or positions that are not finite.
    """
    if not radius > 0:
        raise InputError(f"the connectivity radius must be positive, not {radius}.")
    if backend == "auto":
        backend = "cell_list" if position.device.type == "cuda" else NUMBA
    if backend not in (NUMBA, *BACKENDS):
        raise InputError(f"unknown neighbour backend {backend!r}; known are auto, {NUMBA}, {', '.join(BACKENDS)}.")
    detached = position.detach()
    values = detached.cpu().contiguous().numpy() if backend == NUMBA else None
    if not (all_finite(values) if values is not None else bool(torch.isfinite(position).all())):
        raise InputError("a radius graph needs finite positions.")
    if values is not None:
        first = np.array([0, len(position)])
        if batch is not None and num_graphs > 1:
            first = np.concatenate([[0], np.cumsum(torch.bincount(batch, minlength=num_graphs).cpu().numpy())])
        return torch.from_numpy(neighbours(values, first, radius)).to(position.device)
    if batch is None or num_graphs == 1:
        return _single(detached, radius, backend)
    counts = torch.bincount(batch, minlength=num_graphs).tolist()
    offsets = itertools.accumulate([0, *counts[:-1]])
    parts = torch.split(detached, counts)
    graphs = [_single(part, radius, backend) + offset for part, offset in zip(parts, offsets, strict=True)]
    return torch.cat(graphs, dim=1)


def _single(position: Tensor, radius: float, backend: str) -> Tensor:
    """Return the edges of one graph: candidates of the backend, the common filter, receiver-sorted."""
    if len(position) < 2:
        return torch.empty((2, 0), dtype=torch.int64, device=position.device)
    first, second = BACKENDS[backend](position, radius * _MARGIN)
    difference = position[first] - position[second]
    close = difference.square().sum(dim=1) < radius**2
    first, second = first[close], second[close]
    sender, receiver = torch.cat([first, second]), torch.cat([second, first])
    order = torch.argsort(receiver * position.shape[0] + sender)
    return torch.stack([sender[order], receiver[order]])


def _brute_force(position: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Return every pair i < j; O(N²) memory."""
    pairs = torch.triu_indices(len(position), len(position), offset=1, device=position.device)
    return pairs[0], pairs[1]


def _kdtree(position: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Return the pairs i < j of SciPy's k-d tree; works through the CPU."""
    from scipy.spatial import cKDTree

    tree = cKDTree(position.cpu().numpy())
    pairs = torch.from_numpy(tree.query_pairs(radius, output_type="ndarray")).to(position.device, torch.int64)
    return pairs[:, 0].contiguous(), pairs[:, 1].contiguous()


def _cell_list(position: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Return the pairs of particles in the same or touching cells of edge `radius`, each once; O(N) on any device.

    Particles are sorted by cell; a cell's particles then are one run, found by bisection. Every particle meets the
    runs of half of the touching cells and, in its own cell, the particles behind it in the sorted order. The cells of
    the last axis lie side by side in the order, so that three neighbouring cells there are one run.
    """
    number, dim = position.shape
    device = position.device
    cell = ((position.double() - position.double().amin(dim=0)) / radius).floor().long() + 1
    extent = cell.amax(dim=0) + 2
    stride = torch.ones(dim, dtype=torch.int64, device=device)
    for axis in range(dim - 2, -1, -1):
        stride[axis] = stride[axis + 1] * extent[axis + 1]
    key, order = torch.sort((cell * stride).sum(dim=1))
    offsets = list(itertools.product((-1, 0, 1), repeat=dim - 1))
    half = offsets[len(offsets) // 2 + 1 :]  # the lexicographically later half of the columns of cells
    starts, ends = [], []
    rank = torch.arange(number, device=device)
    starts.append(rank + 1)  # own column of cells: those behind, up to the next cell
    ends.append(torch.searchsorted(key, key + 1, right=True))
    for offset in half:
        shift = (torch.tensor([*offset, 0], device=device) * stride).sum()
        starts.append(torch.searchsorted(key, key + shift - 1, right=False))
        ends.append(torch.searchsorted(key, key + shift + 1, right=True))
    start = torch.cat(starts)
    count = torch.cat(ends) - start
    source = rank.repeat(len(starts)).repeat_interleave(count)
    within = torch.arange(len(source), device=device) - (count.cumsum(0) - count).repeat_interleave(count)
    target = start.repeat_interleave(count) + within
    return order[source], order[target]


def _torch_cluster(position: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Return the pairs i < j of torch-cluster, asked for as many neighbours as there are particles."""
    if importlib.util.find_spec("torch_cluster") is None:
        raise InputError("the neighbour backend 'torch_cluster' needs: pip install 'gns_pl[torch-cluster]'.")
    from torch_cluster import radius_graph as cluster_graph

    # torch-cluster silently drops neighbours beyond the cap; double the cap until nobody reaches it.
    cap = 64
    while True:
        edges = cluster_graph(position, radius, loop=False, max_num_neighbors=cap)
        if cap >= len(position) or not len(edges[1]) or int(torch.bincount(edges[1]).max()) < cap - 1:
            break
        cap *= 2
    once = edges[0] < edges[1]
    return edges[0][once], edges[1][once]


NUMBA = "numba"
"""The backend of compiled loops (`graph.cells`), which finds whole graphs, not candidates."""

BACKENDS: dict[str, Callable[[Tensor, float], tuple[Tensor, Tensor]]] = {
    "brute_force": _brute_force,
    "kdtree": _kdtree,
    "cell_list": _cell_list,
    "torch_cluster": _torch_cluster,
}
"""Backend name → function that returns candidate pairs (each pair once) within the radius."""
