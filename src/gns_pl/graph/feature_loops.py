"""Features on a CPU: what `graph.features` and `graph.context` say, a particle a time.

Of a thousand particles the dozens of small torch operations take ten times as long as their arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.machine import compile_function


@compile_function
def fill_edges(position: Any, edge_index: Any, radius: Any, feature: Any) -> None:
    """Fill in displacement from receiver to sender over the radius, and its length [E, D + 1]."""
    dim = position.shape[1]
    for e in range(edge_index.shape[1]):
        sender, receiver = edge_index[0, e], edge_index[1, e]
        square = np.float32(0)
        for axis in range(dim):
            along = (position[sender, axis] - position[receiver, axis]) / radius
            feature[e, axis] = along
            square += along * along
        feature[e, dim] = np.sqrt(square)


@compile_function
def fill_motion_and_walls(
    velocity: Any, scale: Any, position: Any, lower: Any, upper: Any, batch: Any, radius: Any, feature: Any
) -> int:
    """Fill in velocities [N, H − 1, D] over their scale and distances to walls; return the columns filled."""
    number, steps, dim = velocity.shape
    walls: int = steps * dim
    columns: int = walls + 2 * dim
    one = np.float32(1)
    for i in range(number):
        box = batch[i]
        for step in range(steps):
            for axis in range(dim):
                feature[i, step * dim + axis] = velocity[i, step, axis] / scale
        for axis in range(dim):
            below = (position[i, axis] - lower[box, axis]) / radius
            above = (upper[box, axis] - position[i, axis]) / radius
            feature[i, walls + axis] = min(max(below, -one), one)
            feature[i, walls + dim + axis] = min(max(above, -one), one)
    return columns


@compile_function
def fill_kinds(particle_type: Any, kinds: Any, material: Any, scale: Any, begin: int, feature: Any) -> None:
    """Fill in which of the kinds [K] a particle is, and its material [N, M'] by means and deviations [2, M]."""
    behind = begin + len(kinds)
    for i in range(len(feature)):
        for k in range(len(kinds)):
            feature[i, begin + k] = particle_type[i] == kinds[k]
        for c in range(scale.shape[1]):
            feature[i, behind + c] = (material[i, c] - scale[0, c]) / scale[1, c]


@compile_function
def sum_context(
    position: Any, velocity: Any, batch: Any, volume: Any,
    lower: Any, edge: Any, cells: Any, shape: Any, room: Any, height: Any,
) -> Any:  # fmt: skip
    """Return what `context_fields` does, and what its derivatives need; the grid is one whose nodes all are kept.

    Args:
        position: [N, D] [m].
        velocity: [N, D] [m/s].
        batch: box of every particle [N].
        volume: [N] [m^D].
        lower: of a `ContextGrid`, as are the others.
        edge: of its cells.
        cells: numbers of cells.
        shape: nodes of every axis [D].
        room: of every node.
        height: likewise.

    Returns:
        The fields, one column each [N, D + 4]; what is interpolated of them at the nodes [G, D + 3]; the nodes around
        every particle and their weights, each [N, 2^D].
    """
    number, dim = position.shape
    corners, half = 1 << dim, np.float32(0.5)
    columns, layers = room.shape[0], room.shape[1]
    nodal = np.zeros((columns * layers, dim + 3), np.float32)
    node, weight = np.empty((number, corners), np.int64), np.empty((number, corners), np.float32)
    result = np.zeros((number, dim + 4), np.float32)
    for i in range(number):
        box, first = batch[i], np.int64(batch[i])
        node[i], weight[i] = 0, 1
        stride = np.int64(1)
        for axis in range(dim - 1, -1, -1):
            place = (position[i, axis] - lower[box, axis]) / edge[box, axis]
            if not place > 0:  # NaN neither
                place = np.float32(0)
            place = min(place, cells[box, axis] - np.float32(1e-3))
            base = min(np.floor(place), cells[box, axis] - np.float32(1))
            fraction = place - base
            for corner in range(corners):
                side = (corner >> axis) & 1
                node[i, corner] += (np.int64(base) + side) * stride
                weight[i, corner] *= fraction if side else np.float32(1) - fraction
            stride *= shape[axis]
            if axis == dim - 1:
                result[i, dim + 3] = place * edge[box, axis]
        for corner in range(corners):
            k = node[i, corner] + first * stride
            node[i, corner] = k
            part = weight[i, corner] * volume[i]
            nodal[k, 0] += part
            for axis in range(dim):
                nodal[k, 1 + axis] += part * velocity[i, axis]
    total, below = np.zeros(dim + 1, np.float32), np.zeros(dim + 1, np.float32)
    for column in range(columns):
        total[:] = 0
        for layer in range(layers):
            k = column * layers + layer
            nodal[k, dim + 2] = nodal[k, 0] / room[column, layer, 0]
            for c in range(dim + 1):
                nodal[k, c] = nodal[k, c] / room[column, layer, 0] * height[column, layer, 0]
                total[c] += nodal[k, c]
        below[:] = 0
        for layer in range(layers):
            k = column * layers + layer
            for c in range(dim + 1):
                own = nodal[k, c]
                under = below[c] + half * own if layer else np.float32(0)  # on the floor all lies above
                below[c] += own
                nodal[k, c] = total[c] - under
                if c == 0:
                    nodal[k, dim + 1] = under
    for i in range(number):
        for corner in range(corners):
            k = node[i, corner]
            for c in range(dim + 3):
                result[i, c] += weight[i, corner] * nodal[k, c]
        result[i, dim + 3] -= result[i, dim + 1]
    return result, nodal, node, weight


@compile_function
def fill_context(
    context: Any, position: Any, lower: Any, batch: Any, volume: Any,
    reach: Any, radius: Any, empty: Any, cell: Any, scale: Any, begin: int, feature: Any,
) -> None:  # fmt: skip
    """Fill in the context from column `begin` on.

    Args:
        context: of `sum_context`.
        position: [N, D] [m].
        lower: corner of every box [B, D] [m].
        batch: box of every particle [N].
        volume: [N] [m^D].
        reach: within which the floor is seen [m].
        radius: connectivity radius [m].
        empty: radii within which the empty height is told.
        cell: volume of a cell of the lattice [m^D].
        scale: of velocities [m/s].
        begin: first column.
        feature: [N, F].
    """
    number, dim = position.shape
    one, two = np.float32(1), np.float32(2)
    for i in range(number):
        floor = (position[i, dim - 1] - lower[batch[i], dim - 1]) / reach
        feature[i, begin] = min(max(floor, -one), one)
        feature[i, begin + 1] = context[i, 0] / reach
        feature[i, begin + 2] = min(max(context[i, dim + 3] / radius, -empty), empty)
        feature[i, begin + 3] = two * context[i, dim + 2] * cell / volume[i]
        for axis in range(dim):
            feature[i, begin + 4 + axis] = context[i, 1 + axis] / (reach * scale)
