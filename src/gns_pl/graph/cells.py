"""Neighbours on the CPU in O(N): particles sorted into cells, in compiled loops."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

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
        position: [N, D] [m], finite, particles of a graph one behind the other; D up to 3.
        first: first particle of every graph, and N at the end [B + 1].
        radius: connectivity radius [m].

    Returns:
        Senders and receivers [2, E], sorted by receiver, then by sender.
    """
    return cast(NDArray[np.int64], _neighbours(position, first, radius, position.dtype.type(radius**2)))


@_compiled
def _cells(position: Any, begin: int, end: int, radius: float) -> Any:
    """Sort the particles begin … end of a graph into cells.

    Returns:
        Their cells [n, 3], of which the first axes are 0 in fewer dimensions; their numbers by cell [n]; coordinates in
        that order, axis by axis [3, n]; the place of every cell's first; the numbers of cells of the axes.
    """
    number, dim = end - begin, position.shape[1]
    reach = radius * (1 + 1e-5)  # rounding never loses a pair
    # Never more cells than a few per particle, however far an explosion throws them.
    most = max(1, math.ceil((8 * number) ** (1 / dim)))
    shape, low, edge = np.ones(3, np.int64), np.zeros(3), np.ones(3)
    for axis in range(dim):
        place = 3 - dim + axis
        least = highest = position[begin, axis]
        for i in range(begin, end):
            least, highest = min(least, position[i, axis]), max(highest, position[i, axis])
        low[place], extent = np.float64(least), np.float64(highest) - np.float64(least)
        shape[place] = np.int64(min(max(extent / reach, 1.0), most))
        edge[place] = max(extent / shape[place], reach)
    cell, key = np.zeros((number, 3), np.int64), np.zeros(number, np.int64)
    starts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for i in range(number):
        for axis in range(dim):
            place = 3 - dim + axis
            cell[i, place] = min(np.int64((position[begin + i, axis] - low[place]) / edge[place]), shape[place] - 1)
        key[i] = (cell[i, 0] * shape[1] + cell[i, 1]) * shape[2] + cell[i, 2]
        starts[key[i] + 1] += 1
    for k in range(1, len(starts)):
        starts[k] += starts[k - 1]
    following, order = starts.copy(), np.empty(number, np.int32)
    ordered = np.zeros((3, number), position.dtype)
    for i in range(number):
        place = following[key[i]]
        following[key[i]] += 1
        order[place] = begin + i
        for axis in range(dim):
            ordered[3 - dim + axis, place] = position[begin + i, axis]
    return cell, order, ordered, starts, shape


@_compiled
def _list(position: Any, begin: int, end: int, radius: float, squared: Any, sender: Any, count: int, start: Any) -> Any:
    """List the neighbours of the particles of a graph; return the senders, and how many there are.

    Args:
        position: [N, D] [m].
        begin: the graph's first particle.
        end: the one behind its last.
        radius: connectivity radius [m].
        squared: its square, in the positions' precision.
        sender: those of earlier graphs, and room.
        count: how many these are.
        start: where every particle's senders begin [N + 1]; filled in.
    """
    cell, order, ordered, starts, shape = _cells(position, begin, end, radius)
    dim, number = position.shape[1], end - begin
    x, y, z, square = ordered[0], ordered[1], ordered[2], np.empty(number, position.dtype)
    here = np.zeros(3, position.dtype)
    for i in range(begin, end):
        for axis in range(dim):
            here[3 - dim + axis] = position[i, axis]
        a, b, c = here[0], here[1], here[2]
        u, v, w = cell[i - begin, 0], cell[i - begin, 1], cell[i - begin, 2]
        bottom, top = max(w - 1, 0), min(w + 1, shape[2] - 1)
        for m in range(max(u - 1, 0), min(u + 2, shape[0])):
            for n in range(max(v - 1, 0), min(v + 2, shape[1])):
                column = (m * shape[1] + n) * shape[2]
                low, high = starts[column + bottom], starts[column + top + 1]  # three cells are one run of particles
                if count + high - low > len(sender):
                    # As many as there will be if the others have as many neighbours, and a fifth.
                    expected = np.int64(1.2 * count / (i + 1) * len(position))
                    more = np.empty(expected + len(position) + high - low, np.int32)
                    more[:count] = sender[:count]
                    sender = more
                for place in range(low, high):
                    p, q, r = a - x[place], b - y[place], c - z[place]
                    square[place - low] = p * p + q * q + r * r
                for place in range(low, high):
                    sender[count] = order[place]
                    count += (square[place - low] < squared) & (order[place] != i)
        start[i + 1] = count
    return sender, count


@_compiled
def _neighbours(position: Any, first: Any, radius: float, squared: Any) -> Any:
    number = len(position)
    # Numbers of particles take four bytes until the edges are counted: fewer than 2³¹ fit into any memory.
    sender, count, start = np.empty(20 * number + 1, np.int32), 0, np.zeros(number + 1, np.int64)
    for graph in range(len(first) - 1):
        if first[graph + 1] > first[graph]:
            sender, count = _list(position, first[graph], first[graph + 1], radius, squared, sender, count, start)
    # Whoever is a neighbour has one: what is listed as i's neighbours is handed to these, and comes in ascending order.
    edge_index, following = np.empty((2, count), np.int64), start[:-1].copy()
    for i in range(number):
        for slot in range(start[i], start[i + 1]):
            j = sender[slot]
            edge_index[0, following[j]] = i
            following[j] += 1
            edge_index[1, slot] = i
    return edge_index


@_compiled
def all_finite(values: Any) -> bool:
    """Return whether all numbers of an array [N, D] are finite."""
    for i in range(values.shape[0]):
        for axis in range(values.shape[1]):
            if not np.isfinite(values[i, axis]):
                return False
    return True


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
