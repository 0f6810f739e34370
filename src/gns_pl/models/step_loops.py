"""What a simulator does behind its network, as compiled loops for a CPU, there and back (`Simulator`).

Each is one operation for autograd, with derivatives by the network's output and by the history.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from gns_pl.machine import compile_function

Array = NDArray[Any]


@compile_function
def _gated_in_contact(
    output: Any, gated: bool, history: Any, dt: Any, scale: Any,
    edge_index: Any, lower: Any, upper: Any, gravity: Any, batch: Any, radius: Any,
) -> Any:  # fmt: skip
    """Return the normalised acceleration [N, D], zero without a neighbour or a wall within the radius; and who has one.

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
        contact[i] = touches
    return result, contact


@compile_function
def _gated_in_contact_backward(
    above: Any, contact: Any, output: Any, gated: bool, history: Any, dt: Any, scale: Any, gravity: Any, batch: Any
) -> Any:
    """Return gradients by the output and by the history of `_gated_in_contact`; `contact` is who touches [N] bool."""
    number, last, dim = len(history), history.shape[1] - 1, history.shape[2]
    to_output, to_history = np.zeros(output.shape, np.float32), np.zeros(history.shape, np.float32)
    one = np.float32(1)
    for i in range(number):
        if contact[i]:
            for axis in range(dim):
                to_output[i, axis] = above[i, axis]
                if gated:
                    velocity = (history[i, last, axis] - history[i, last - 1, axis]) / dt
                    falling = velocity / dt + gravity[batch[i], axis]
                    share = one / (one + np.exp(output[i, dim + axis]))
                    to_output[i, dim + axis] = above[i, axis] * share * (one - share) * falling / scale
                    along = above[i, axis] * share / (scale * dt * dt)
                    to_history[i, last, axis] = -along
                    to_history[i, last - 1, axis] = along
    return to_output, to_history


@compile_function
def _integrate(
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


@compile_function
def _integrate_backward(
    above: Any, history: Any, normalised: Any, scale: Any, dt: Any, lower: Any, upper: Any, gravity: Any, batch: Any,
    moved: Any,
) -> Any:  # fmt: skip
    """Return gradients by the history and by the normalised acceleration of `_integrate`; on a wall there are none."""
    number, last, dim = len(history), history.shape[1] - 1, history.shape[2]
    to_history, to_normalised = np.zeros(history.shape, np.float32), np.zeros(normalised.shape, np.float32)
    for i in range(number):
        box = batch[i]
        for axis in range(dim):
            given = above[i, axis]
            if not moved[i]:
                to_history[i, last, axis] = given
                continue
            place, least, most = history[i, last, axis], lower[box, axis], upper[box, axis]
            acceleration = normalised[i, axis] * scale + gravity[box, axis]
            step = ((place - history[i, last - 1, axis]) / dt + acceleration * dt) * dt
            if least <= place + step <= most and abs(step) <= most - least:
                to_history[i, last, axis] = given + given
                to_history[i, last - 1, axis] = -given
                to_normalised[i, axis] = given * scale * dt * dt
    return to_history, to_normalised


class _InContact(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, output: Tensor, history: Tensor, gated: bool, *constants: Any) -> Tensor:
        result, ctx.contact = _gated_in_contact(_array(output), gated, _array(history), *constants)
        ctx.save_for_backward(output, history)
        dt, scale, _, _, _, gravity, batch, _ = constants
        ctx.gated, ctx.constants = gated, (dt, scale, gravity, batch)
        return torch.from_numpy(result)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Any, ...]:
        output, history = map(_array, ctx.saved_tensors)
        gradients = _gated_in_contact_backward(_array(above), ctx.contact, output, ctx.gated, history, *ctx.constants)
        return *map(torch.from_numpy, gradients), None, *[None] * 8


class _Integrated(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, history: Tensor, normalised: Tensor, *constants: Any) -> Tensor:
        ctx.save_for_backward(history, normalised)
        ctx.constants = constants
        return torch.from_numpy(_integrate(_array(history), _array(normalised), *constants))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Any, ...]:
        arrays = map(_array, (above, *ctx.saved_tensors))
        return *map(torch.from_numpy, _integrate_backward(*arrays, *ctx.constants)), *[None] * len(ctx.constants)


def gated_in_contact(output: Tensor, history: Tensor, gated: bool, *constants: Any) -> Tensor:
    """Return the normalised acceleration [N, D]; arguments as of `_gated_in_contact`."""
    return cast(Tensor, _InContact.apply(output, history, gated, *constants))  # type: ignore[no-untyped-call]


def integrated(history: Tensor, normalised: Tensor, *constants: Any) -> Tensor:
    """Return the next position [N, D] [m]; arguments as of `_integrate`."""
    return cast(Tensor, _Integrated.apply(history, normalised, *constants))  # type: ignore[no-untyped-call]


def _array(tensor: Tensor) -> Array:
    array: Array = tensor.detach().contiguous().numpy()
    return array
