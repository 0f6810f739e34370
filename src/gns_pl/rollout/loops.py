"""What `rollout.stabilise` and `rollout.rest` do to particles one by one, as compiled loops for the CPU.

Of a thousand particles the small torch operations for it take as long as the network does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.machine import compile_function


@compile_function
def move_apart(
    position: Any, searched: Any, radius: float, pairs: Any, least: Any, sweeps: int, batch: Any, lower: Any, upper: Any
) -> Any:
    """Move particles of pairs that are too close apart, each by half of what is missing, some times over.

    Args:
        position: changed in place [N, D] [m].
        searched: where they were when the pairs were found [N, D] [m].
        radius: all pairs nearer than that were found [m].
        pairs: both ways [2, P].
        least: distance that is wanted [m].
        sweeps: times.
        batch: box of every particle [N].
        lower: corner of every box [B, D] [m].
        upper: likewise.

    Returns:
        The times that are left when particles are where others may be too close.
    """
    number, dim = position.shape
    half, tiny, limit = np.float32(0.5), np.float32(1e-6) * least, least * least
    shift, begun, apart = np.empty_like(position), position.copy(), 0.0
    for axis in range(dim):  # how far two have moved apart since the search, at most
        least_move = most_move = position[0, axis] - searched[0, axis]
        for i in range(1, number):
            move = position[i, axis] - searched[i, axis]
            least_move, most_move = min(least_move, move), max(most_move, move)
        apart += (most_move - least_move) ** 2
    # Of two that were further apart than the radius then, each may move by so much before they are too close.
    room = 0.49 * (radius - least - np.sqrt(apart))
    if room <= 0:
        return sweeps
    while sweeps > 0:
        sweeps -= 1
        shift[:] = 0
        nothing = True
        for e in range(pairs.shape[1]):
            j, i = pairs[0, e], pairs[1, e]
            along = position[i, 0] - position[j, 0]
            square = along * along
            for axis in range(1, dim):
                along = position[i, axis] - position[j, axis]
                square += along * along
            if not square < limit:
                continue
            nothing, distance = False, np.sqrt(square)
            if distance > tiny:
                for axis in range(dim):
                    along = (position[i, axis] - position[j, axis]) / distance
                    shift[i, axis] += half * (least - distance) * along
            else:  # two in one place: the one of the higher number goes up
                shift[i, dim - 1] += half * (least - distance) * (1 if i > j else -1)
        if nothing:
            return 0
        farthest = np.float32(0)
        for i in range(number):
            square = np.float32(0)
            for axis in range(dim):
                place = position[i, axis] + shift[i, axis]
                place = min(max(place, lower[batch[i], axis]), upper[batch[i], axis])
                position[i, axis] = place
                square += (place - begun[i, axis]) ** 2
            farthest = max(farthest, square)
        if not farthest < room * room:
            return sweeps
    return 0


@compile_function
def flight_offset(
    dt: float, radius: float, rounding: float, earlier: Any, before: Any, position: Any, volume: Any, moved: Any,
    batch: Any, gravity: Any, lower: Any, upper: Any,
) -> Any:  # fmt: skip
    """Return how far every scene's centre of mass is from free flight; 0 where something is near a wall [B, D] [m].

    Args:
        dt: time of the step [s].
        radius: near [m].
        rounding: share of a box's edge that is nothing.
        earlier: positions before the step before [N, D] [m].
        before: before the step.
        position: behind it.
        volume: weights [N].
        moved: particles that a simulator moves [N] bool.
        batch: scene of every particle [N].
        gravity: [B, D] [m/s²].
        lower: corner of every box [B, D] [m].
        upper: likewise.
    """
    number, dim = position.shape
    limit, held, flying = np.float32(radius), np.zeros(len(gravity), np.bool_), len(gravity)
    sums, weights = np.zeros((len(gravity), dim)), np.zeros(len(gravity))
    for i in range(number):
        box = batch[i]
        if held[box]:
            continue
        free = moved[i]
        for axis in range(dim):
            for place in (before[i, axis], position[i, axis]):
                free = free and place - lower[box, axis] > limit and upper[box, axis] - place > limit
        if not free:  # or not a number
            held[box] = True
            flying -= 1
            if flying == 0:
                break
    offset = np.zeros((len(gravity), dim), np.float32)
    if flying == 0:
        return offset
    for i in range(number):
        box = batch[i]
        weights[box] += volume[i]
        for axis in range(dim):
            fall = np.float64(position[i, axis]) - 2 * np.float64(before[i, axis]) + np.float64(earlier[i, axis])
            sums[box, axis] += volume[i] * (fall - np.float64(gravity[box, axis]) * dt * dt)
    for box in range(len(gravity)):
        if not held[box]:
            for axis in range(dim):
                mean = sums[box, axis] / weights[box]
                if np.abs(mean) > rounding * (upper[box, axis] - lower[box, axis]):
                    offset[box, axis] = mean
    return offset


@compile_function
def slowing(
    dt: float, rounding: float, slow: Any, earlier: Any, before: Any, position: Any, volume: Any, moved: Any,
    batch: Any, gravity: Any, lower: Any, upper: Any,
) -> Any:  # fmt: skip
    """Return of every scene by what `StableStepper` scales its velocities [B]; 1, or NaN: by nothing.

    Args:
        dt: time of the step [s].
        rounding: share by which the energy may rise.
        slow: motion of every particle that may be there from nothing, per mass [N] [m²/s²].
        earlier: positions before the step before [N, D] [m].
        before: before the step.
        position: behind it.
        volume: weights [N].
        moved: particles that a simulator moves [N] bool.
        batch: scene of every particle [N].
        gravity: [B, D] [m/s²].
        lower: corner of every box [B, D] [m].
        upper: likewise.
    """
    # Energy of motion behind the step; what height adds in its middle, with the opposite sign; height before it; motion
    # and height of the step before; motion of what a script moves; motion of the step before; what that may be.
    sums = np.zeros((len(gravity), 7))
    for i in range(len(position)):
        box = batch[i]
        quadratic, linear, height, kinetic, risen = 0.0, 0.0, 0.0, 0.0, 0.0
        for axis in range(position.shape[1]):
            pull = np.float64(gravity[box, axis])
            velocity = np.float64(position[i, axis] - before[i, axis]) / dt
            past = np.float64(before[i, axis] - earlier[i, axis]) / dt
            quadratic += velocity * velocity / 2
            linear -= pull * velocity * dt / 2
            lowest = upper[box, axis] if pull > 0 else lower[box, axis]
            height += (lowest - before[i, axis]) * pull
            kinetic += past * past / 2
            risen += pull * past * dt / 2
        sums[box, 0] += volume[i] * quadratic
        sums[box, 1] += volume[i] * linear
        sums[box, 2] += volume[i] * height
        sums[box, 3] += volume[i] * (kinetic + risen)
        sums[box, 4] += 0.0 if moved[i] else volume[i] * 2 * kinetic
        sums[box, 5] += volume[i] * kinetic
        sums[box, 6] += volume[i] * slow[i]
    factor = np.ones(len(gravity))
    for box in range(len(gravity)):
        quadratic, linear, height, past, pushed = sums[box, 0], sums[box, 1], sums[box, 2], sums[box, 3], sums[box, 4]
        allowed = (past + height) * (1 + rounding) - height + max(sums[box, 6] - sums[box, 5], 0.0)
        if not (pushed > 0 or quadratic + linear <= allowed):
            root = np.sqrt(max(linear * linear + 4 * quadratic * allowed, 0.0))
            share = (root - linear) / max(2 * quadratic, 1e-30)
            factor[box] = 0.0 if share < 0 else 1.0 if share > 1 else share
    return factor


@compile_function
def is_moving(history: Any, steps: int, step: float) -> Any:
    """Return which particles made one of the latest `steps` steps of `step` or longer, or whose history has a NaN.

    Args:
        history: [N, H, D] [m].
        steps: that count.
        step: [m].

    Returns:
        [N] bool.
    """
    number, length, dim = history.shape
    moving = np.zeros(number, np.bool_)
    for i in range(number):
        for frame in range(length - steps):
            for axis in range(dim):
                if np.isnan(history[i, frame, axis]):
                    moving[i] = True
        for frame in range(length - steps, length):
            square = np.float32(0)
            for axis in range(dim):
                along = history[i, frame, axis] - history[i, frame - 1, axis]
                square += along * along
            if not square < np.float32(step * step):
                moving[i] = True
    return moving


@compile_function
def spread(edge_index: Any, moving: Any) -> Any:
    """Return which particles move or have a neighbour that does, and these with all who send to them, each [N] bool."""
    awake = moving.copy()
    for e in range(edge_index.shape[1]):
        if moving[edge_index[0, e]]:
            awake[edge_index[1, e]] = True
    reached = awake.copy()
    for e in range(edge_index.shape[1]):
        if awake[edge_index[1, e]]:
            reached[edge_index[0, e]] = True
    return awake, reached


@compile_function
def passed(edge_index: Any, reached: Any) -> Any:
    """Return the edges to particles that are reached, and all nodes that these edges need.

    Args:
        edge_index: [2, E].
        reached: [N] bool.

    Returns:
        Edges between the nodes' places [2, e], which of all edges they are [e], and the nodes, ascending [n].
    """
    visible, count = reached.copy(), 0
    for e in range(edge_index.shape[1]):
        if reached[edge_index[1, e]]:
            visible[edge_index[0, e]] = True
            count += 1
    place, nodes = np.cumsum(visible) - 1, np.nonzero(visible)[0]
    edges, kept, slot = np.empty((2, count), np.int64), np.empty(count, np.int64), 0
    for e in range(edge_index.shape[1]):
        if reached[edge_index[1, e]]:
            edges[0, slot], edges[1, slot] = place[edge_index[0, e]], place[edge_index[1, e]]
            kept[slot] = e
            slot += 1
    return edges, kept, nodes
