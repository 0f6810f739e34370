"""Neighbours on the CPU in O(N): particles sorted into cells, in compiled loops."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from gns_pl.machine import compile_function

F = TypeVar("F", bound=Callable[..., Any])
_compiled: Callable[[F], F] = functools.partial(compile_function, nogil=True)
_inlined: Callable[[F], F] = numba.njit(nogil=True, inline="always")


def neighbours(position: NDArray[np.floating], first: NDArray[np.int64], radius: float) -> NDArray[np.int64]:
    """Return all pairs of one graph closer than `radius`, both ways.

    Args:
        position: [N, D] [m], finite, particles of a graph one behind the other.
        first: first particle of every graph, and N at the end [B + 1].
        radius: connectivity radius [m].

    Returns:
        Senders and receivers [2, E], sorted by receiver, then by sender.
    """
    start = np.zeros(len(position) + 1, dtype=np.int64)
    sorted_graphs = [_sort(position[a:b], radius) for a, b in itertools.pairwise(first) if b > a]
    offsets = [int(a) for a, b in itertools.pairwise(first) if b > a]
    squared = position.dtype.type(radius**2)
    for cells, offset in zip(sorted_graphs, offsets, strict=True):
        _count(cells, squared, offset, start)
    np.cumsum(start, out=start)
    edge_index = np.empty((2, start[-1]), dtype=np.int64)
    for cells, offset in zip(sorted_graphs, offsets, strict=True):
        _list(cells, squared, offset, start, *edge_index)
    return edge_index


def _sort(position: NDArray[np.floating], radius: float) -> Any:
    """Return positions and numbers of the particles by cell, the cell of each [N, D], and the first of every cell."""
    number, dim = position.shape
    low, high = position.min(axis=0).astype(np.float64), position.max(axis=0).astype(np.float64)
    reach = radius * (1 + 1e-5)  # rounding never loses a pair
    # Never more cells than a few per particle, however far an explosion throws them.
    most = max(1, math.ceil((8 * number) ** (1 / dim)))
    shape = np.clip((high - low) / reach, 1, most).astype(np.int64)
    return _into_cells(position, low, np.maximum((high - low) / shape, reach), shape)


@_compiled
def _into_cells(position: Any, low: Any, edge: Any, shape: Any) -> Any:
    number, dim = position.shape
    cell = np.empty((number, dim), np.int64)
    key = np.zeros(number, np.int64)
    begin = np.zeros(shape.prod() + 1, np.int64)
    for i in range(number):
        for axis in range(dim):
            cell[i, axis] = min(np.int64((position[i, axis] - low[axis]) / edge[axis]), shape[axis] - 1)
            key[i] = key[i] * shape[axis] + cell[i, axis]
        begin[key[i] + 1] += 1
    begin = begin.cumsum()
    place = begin.copy()
    order, sorted_position = np.empty(number, np.int64), np.empty_like(position)
    for i in range(number):
        order[place[key[i]]] = i
        for axis in range(dim):
            sorted_position[place[key[i]], axis] = position[i, axis]
        place[key[i]] += 1
    return position, sorted_position, order, cell, begin, shape


@_inlined
def _run(cell: Any, i: int, shape: Any, column: int) -> tuple[int, int]:
    """Return the first and last cell of a run of three along the last axis, in one of the 3^(D−1) columns around."""
    dim = len(shape)
    key = np.int64(0)
    for axis in range(dim - 1):
        beside = cell[i, axis] + column % 3 - 1
        column //= 3
        if not 0 <= beside < shape[axis]:
            return 0, -1
        key = key * shape[axis] + beside
    key *= shape[dim - 1]
    return key + max(cell[i, dim - 1] - 1, 0), key + min(cell[i, dim - 1] + 1, shape[dim - 1] - 1)


@_inlined
def _squared_distance(a: Any, i: int, b: Any, j: int) -> Any:
    # One array element at a time: a row as an array of its own would cost more than the arithmetic.
    along = a[i, 0] - b[j, 0]
    total = along * along
    for axis in range(1, a.shape[1]):
        along = a[i, axis] - b[j, axis]
        total += along * along
    return total


@_compiled
def _count(cells: Any, squared: Any, offset: int, start: Any) -> None:
    """Put the number of neighbours of particle `offset` + i into start[`offset` + i + 1]."""
    position, sorted_position, _, cell, begin, shape = cells
    for i in range(len(position)):
        count = -1  # itself
        for column in range(3 ** (len(shape) - 1)):
            low, high = _run(cell, i, shape, column)
            for place in range(begin[low], begin[high + 1]):
                count += _squared_distance(position, i, sorted_position, place) < squared
        start[offset + i + 1] = count


@_compiled
def _list(cells: Any, squared: Any, offset: int, start: Any, sender: Any, receiver: Any) -> None:
    """List the neighbours of every particle from its place in `start` on, senders ascending."""
    position, sorted_position, order, cell, begin, shape = cells
    for i in range(len(order)):
        into = start[offset + i]
        slot = into
        for column in range(3 ** (len(shape) - 1)):
            low, high = _run(cell, i, shape, column)
            for place in range(begin[low], begin[high + 1]):
                j = order[place]
                if j != i and _squared_distance(position, i, sorted_position, place) < squared:
                    receiver[slot] = offset + i
                    before = slot
                    while before > into and sender[before - 1] > offset + j:
                        sender[before] = sender[before - 1]
                        before -= 1
                    sender[before] = offset + j
                    slot += 1


@_compiled
def filter_pairs(position: Any, pairs: Any, squared: Any) -> Any:
    """Return those of the pairs [2, P] that are closer than the root of `squared`, in their order [2, E]."""
    kept = np.empty(pairs.shape[1], np.int64)
    count = 0
    for pair in range(pairs.shape[1]):
        kept[count] = pair
        count += _squared_distance(position, pairs[1, pair], position, pairs[0, pair]) < squared
    edge_index = np.empty((2, count), np.int64)
    for edge in range(count):
        edge_index[0, edge] = pairs[0, kept[edge]]
        edge_index[1, edge] = pairs[1, kept[edge]]
    return edge_index
