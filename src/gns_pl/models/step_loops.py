"""What a simulator does behind its network, as compiled loops for a CPU without gradients (`Simulator`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.machine import compile_function


@compile_function
def gated_in_contact(
    output: Any, gated: bool, history: Any, dt: Any, scale: Any,
    edge_index: Any, lower: Any, upper: Any, gravity: Any, batch: Any, radius: Any,
) -> Any:  # fmt: skip
    """Return the normalised acceleration [N, D]: zero without a neighbour or a wall within the radius.

    Args:
        output: of the network [N, D], or [N, 2 D] with the gate in the later columns.
        gated: whether there is one.
        history: [N, H, D] [m].
        dt: time of the step [s].
        scale: of accelerations [m/s²].
        edge_index: [2, E].
        lower: corner of every box [B, D] [m].
        upper: likewise.
        gravity: [B, D] [m/s²].
        batch: box of every particle [N].
        radius: connectivity radius [m].
    """
    number, dim = len(history), history.shape[2]
    last = history.shape[1] - 1
    contact = np.zeros(number, np.bool_)
    for e in range(edge_index.shape[1]):
        if edge_index[0, e] != edge_index[1, e]:  # a node itself is padding
            contact[edge_index[1, e]] = True
    result = np.zeros((number, dim), np.float32)
    one = np.float32(1)
    for i in range(number):
        box, touches = batch[i], contact[i]
        for axis in range(dim):
            place = history[i, last, axis]
            touches |= (place - lower[box, axis] < radius) | (upper[box, axis] - place < radius)
        if touches:
            for axis in range(dim):
                value = output[i, axis]
                if gated:
                    velocity = (history[i, last, axis] - history[i, last - 1, axis]) / dt
                    falling = velocity / dt + gravity[box, axis]  # (v + g Δt) / Δt
                    value -= one / (one + np.exp(output[i, dim + axis])) * falling / scale
                result[i, axis] = value
    return result


@compile_function
def integrated(
    history: Any, normalised: Any, scale: Any, dt: Any, lower: Any, upper: Any, gravity: Any, batch: Any, moved: Any
) -> Any:
    """Return the next position [N, D] [m].

    Args:
        history: [N, H, D] [m].
        normalised: (a − g) / `scale` [N, D].
        scale: of accelerations [m/s²].
        dt: time of the step [s].
        lower: corner of every box [B, D] [m].
        upper: likewise.
        gravity: [B, D] [m/s²].
        batch: box of every particle [N].
        moved: particles that are not kinematic [N] bool.
    """
    number, last, dim = len(history), history.shape[1] - 1, history.shape[2]
    result = np.empty((number, dim), np.float32)
    for i in range(number):
        box = batch[i]
        for axis in range(dim):
            place, least, most = history[i, last, axis], lower[box, axis], upper[box, axis]
            if moved[i]:
                acceleration = normalised[i, axis] * scale + gravity[box, axis]
                velocity = (place - history[i, last - 1, axis]) / dt + acceleration * dt
                step = velocity * dt
                place += step
                if place < least:
                    place = least
                elif place > most:
                    place = most
                if abs(step) > most - least:
                    place = np.float32(np.nan)
            result[i, axis] = place
    return result
