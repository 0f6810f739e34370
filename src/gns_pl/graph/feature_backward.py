"""The way back through `graph.feature_loops`: derivatives by positions and velocities, a particle a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.machine import compile_function


@compile_function
def edges_backward(feature: Any, edge_index: Any, radius: Any, above: Any, to_position: Any) -> None:
    """Add to gradients by positions [N, D] those of edge features [E, D + 1]; one of no length has no direction."""
    dim = to_position.shape[1]
    for e in range(edge_index.shape[1]):
        sender, receiver, length = edge_index[0, e], edge_index[1, e], feature[e, dim]
        share = above[e, dim] / length if length > 0 else np.float32(0)
        for axis in range(dim):
            along = (above[e, axis] + share * feature[e, axis]) / radius
            to_position[sender, axis] += along
            to_position[receiver, axis] -= along


@compile_function
def motion_and_walls_backward(
    above: Any, scale: Any, position: Any, lower: Any, upper: Any, batch: Any, radius: Any,
    to_velocity: Any, to_position: Any,
) -> int:  # fmt: skip
    """Fill in gradients by velocities [N, H − 1, D], and add those by positions [N, D]; return the columns read."""
    number, steps, dim = to_velocity.shape
    walls: int = steps * dim
    columns: int = walls + 2 * dim
    for i in range(number):
        box = batch[i]
        for step in range(steps):
            for axis in range(dim):
                to_velocity[i, step, axis] = above[i, step * dim + axis] / scale
        for axis in range(dim):
            below = (position[i, axis] - lower[box, axis]) / radius
            over = (upper[box, axis] - position[i, axis]) / radius
            if -1 <= below <= 1:
                to_position[i, axis] += above[i, walls + axis] / radius
            if -1 <= over <= 1:
                to_position[i, axis] -= above[i, walls + dim + axis] / radius
    return columns


@compile_function
def context_backward(
    above: Any, context: Any, position: Any, lower: Any, batch: Any, volume: Any,
    reach: Any, radius: Any, empty: Any, cell: Any, scale: Any, begin: int, to_position: Any,
) -> Any:  # fmt: skip
    """Return the gradient by the context [N, D + 4], and add that of the floor to those by positions [N, D].

    Args:
        above: gradient by the features [N, F].
        context: as of `fill_context`, as are the others.
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
        to_position: gradients that are added to.
    """
    number, dim = position.shape
    two, result = np.float32(2), np.zeros(context.shape, np.float32)
    for i in range(number):
        if -1 <= (position[i, dim - 1] - lower[batch[i], dim - 1]) / reach <= 1:
            to_position[i, dim - 1] += above[i, begin] / reach
        result[i, 0] = above[i, begin + 1] / reach
        if -empty <= context[i, dim + 3] / radius <= empty:
            result[i, dim + 3] = above[i, begin + 2] / radius
        result[i, dim + 2] = two * above[i, begin + 3] * cell / volume[i]
        for axis in range(dim):
            result[i, 1 + axis] = above[i, begin + 4 + axis] / (reach * scale)
    return result


@compile_function
def sums_backward(
    above: Any, nodal: Any, node: Any, weight: Any, position: Any, velocity: Any, batch: Any, volume: Any,
    lower: Any, edge: Any, cells: Any, shape: Any, room: Any, height: Any, to_position: Any, to_velocity: Any,
) -> None:  # fmt: skip
    """Add to gradients by positions [N, D] and latest velocities [N, D] those of `sum_context`.

    Args:
        above: gradient by its result [N, D + 4].
        nodal: what it had at the nodes of the grid [G, D + 3].
        node: those around every particle [N, 2^D].
        weight: and their weights [N, 2^D].
        position: as of `sum_context`, as are the others.
        velocity: [N, D] [m/s].
        batch: box of every particle [N].
        volume: [N] [m^D].
        lower: of a `ContextGrid`, as are the others.
        edge: of its cells.
        cells: numbers of cells.
        shape: nodes of every axis [D].
        room: of every node.
        height: likewise.
        to_position: gradients that are added to.
        to_velocity: likewise.
    """
    number, dim = position.shape
    corners, half = 1 << dim, np.float32(0.5)
    columns, layers = room.shape[0], room.shape[1]
    given, under = np.zeros((columns * layers, dim + 3), np.float32), dim + 1
    to_weight = np.zeros((number, corners), np.float32)
    for i in range(number):
        above[i, under] -= above[i, dim + 3]  # the empty height is that over the floor less what lies below
        for corner in range(corners):
            k = node[i, corner]
            for c in range(dim + 3):
                given[k, c] += weight[i, corner] * above[i, c]
                to_weight[i, corner] += nodal[k, c] * above[i, c]
    for column in range(columns):
        for c in range(dim + 1):
            total = np.float32(0)
            for layer in range(layers):
                total += given[column * layers + layer, c]
            for layer in range(layers - 1, -1, -1):
                k = column * layers + layer
                # By what lies under a node, of which a part of the column is above and the rest below.
                own = (given[k, under] if c == 0 else np.float32(0)) - given[k, c] if layer else np.float32(0)
                given[k, c] = (total + half * own) * height[column, layer, 0] / room[column, layer, 0]
                total += own
        for layer in range(layers):
            k = column * layers + layer
            given[k, 0] += given[k, dim + 2] / room[column, layer, 0]
    fraction, inside = np.empty(dim, np.float32), np.empty(dim, np.bool_)
    for i in range(number):
        box = batch[i]
        for axis in range(dim):
            place = (position[i, axis] - lower[box, axis]) / edge[box, axis]
            inside[axis] = 0 <= place < cells[box, axis] - np.float32(1e-3)
            place = min(max(place, np.float32(0)), cells[box, axis] - np.float32(1e-3))
            fraction[axis] = place - min(np.floor(place), cells[box, axis] - np.float32(1))
        if inside[dim - 1]:
            to_position[i, dim - 1] += above[i, dim + 3]
        for corner in range(corners):
            k = node[i, corner]
            along = given[k, 0]
            for axis in range(dim):
                along += velocity[i, axis] * given[k, 1 + axis]
                to_velocity[i, axis] += weight[i, corner] * volume[i] * given[k, 1 + axis]
            along = to_weight[i, corner] + along * volume[i]
            for axis in range(dim):
                if inside[axis]:
                    part = along / edge[box, axis]
                    for other in range(dim):
                        side = (corner >> other) & 1
                        if other == axis:
                            part *= np.float32(2 * side - 1)
                        else:
                            part *= fraction[other] if side else np.float32(1) - fraction[other]
                    to_position[i, axis] += part


@compile_function
def material_backward(above: Any, scale: Any, begin: int, to_material: Any) -> None:
    """Fill in gradients by the material features that are used [N, M], which stand in columns from `begin` on."""
    for i in range(len(above)):
        for c in range(scale.shape[1]):
            to_material[i, c] = above[i, begin + c] / scale[1, c]
