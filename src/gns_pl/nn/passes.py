"""Encoders, message-passing layers and decoder as compiled loops over tiles of edges and of nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gns_pl.nn.compiled import compiled
from gns_pl.nn.lanes import LANES, ROWS, STRIDE, add_product, load, rectify, repeat, store, total

Array = NDArray[np.float32]


class Weights(NamedTuple):
    """A multilayer perceptron's weights; W is the states' width L padded to a multiple of `LANES`, with zeros.

    Attributes:
        first: of the first layer [F, W], F padded to a multiple of `BAND`.
        deeper: of those behind it [D, W, W].
        biases: of all [1 + D, W].
        norm: weight and bias [2, W]; the mean that it subtracts is taken off the layer before it.
        share: 1 / L, and what the norm adds to a variance [2].
    """

    first: Array
    deeper: Array
    biases: Array
    norm: Array
    share: Array


class Turned(NamedTuple):
    """A multilayer perceptron's weights for the way back: its matrices transposed.

    Attributes:
        first: of every part of the input [parts, W, W]; of features [1, W, F'], F' a multiple of `LANES`.
        deeper: [D, W, W].
    """

    first: Array
    deeper: Array


@compiled
def zero_tile() -> Array:
    """Return a tile of zeros."""
    return np.zeros(ROWS * STRIDE, np.float32)


@compiled
def fill(tile: Array, bias: Array, row: int) -> None:
    """Put a row of biases into every row of a tile."""
    width = bias.shape[1]
    for c in range(0, width, LANES):
        value = load(bias, row * width + c)
        for r in range(ROWS):
            store(tile, r * STRIDE + c, value)


@compiled
def copy(tile: Array, rows: Array, begin: int) -> None:
    """Put rows of an array, which has `ROWS` more than are needed, into a tile."""
    width = rows.shape[1]
    for r in range(ROWS):
        for c in range(0, width, LANES):
            store(tile, r * STRIDE + c, load(rows, (begin + r) * width + c))


@compiled
def product(into: Array, tile: Array, weight: Array, begin: int, depth: int, width: int) -> None:
    """Add the product of a tile with a matrix, which begins at `begin`."""
    for c in range(0, width, LANES):
        add_product(into, tile, c, weight, begin, width, depth)


@compiled
def _rest(mlp: Weights, hidden: Array, other: Array) -> Any:
    """Go on behind the first layer; return the tile with the output before the norm, and the other one."""
    deeper = mlp.deeper
    width = deeper.shape[2]
    for d in range(deeper.shape[0]):
        for r in range(ROWS):
            for c in range(0, width, LANES):
                store(hidden, r * STRIDE + c, rectify(load(hidden, r * STRIDE + c)))
        fill(other, mlp.biases, d + 1)
        product(other, hidden, deeper, d * width * width, width, width)
        hidden, other = other, hidden
    return hidden, other


@compiled
def scale_of(mlp: Weights, tile: Array, r: int) -> Any:
    """Return 1 / deviation of a tile's row, whose mean is zero."""
    square = repeat(np.float32(0))
    for c in range(0, mlp.norm.shape[1], LANES):
        part = load(tile, r * STRIDE + c)
        square = square + part * part
    return repeat(np.float32(1) / np.sqrt(total(square) * mlp.share[0] + mlp.share[1]))


@compiled
def normal_form(mlp: Weights, tile: Array, r: int, c: int, scale: Any) -> Any:
    """Return sixteen numbers of a tile's row behind the norm."""
    return load(tile, r * STRIDE + c) * scale * load(mlp.norm, c) + load(mlp.norm, mlp.norm.shape[1] + c)


@compiled
def encode_nodes(mlp: Weights, feature: Array, node: Array, low: int, high: int) -> None:
    """Encode node features [N, F] into states [N + ROWS, W]."""
    inputs, width = feature.shape[1], mlp.first.shape[1]
    hidden, other, rows = zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        for r in range(count):
            for c in range(inputs):
                rows[r * STRIDE + c] = feature[begin + r, c]
        fill(hidden, mlp.biases, 0)
        product(hidden, rows, mlp.first, 0, inputs, width)
        hidden, other = _rest(mlp, hidden, other)
        for r in range(count):
            scale = scale_of(mlp, hidden, r)
            for c in range(0, width, LANES):
                store(node, (begin + r) * width + c, normal_form(mlp, hidden, r, c, scale))


@compiled
def hand_on(ends: Array, biases: Array, node: Array, sending: Array, receiving: Array, low: int, high: int) -> None:
    """Make of node states what a layer's messages need of both ends; `ends` are their weights [2, W, W]."""
    width = ends.shape[1]
    hidden, rows = zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        copy(rows, node, begin)
        hidden[:] = 0
        product(hidden, rows, ends, 0, width, width)
        for r in range(count):
            for c in range(0, width, LANES):
                store(sending, (begin + r) * width + c, load(hidden, r * STRIDE + c))
        fill(hidden, biases, 0)
        product(hidden, rows, ends, width * width, width, width)
        for r in range(count):
            for c in range(0, width, LANES):
                store(receiving, (begin + r) * width + c, load(hidden, r * STRIDE + c))


@compiled
def pass_messages(
    encoder: Weights, mlp: Weights, feature: Array, state: Array, kept: Array, sender: Any, start: Any,
    sending: Array, receiving: Array, received: Array, encodes: bool, keeps: bool, updates: bool,
    low: int, high: int,
) -> None:  # fmt: skip
    """Add the messages of a layer to the sums at receivers low … high.

    Args:
        encoder: of edges.
        mlp: of messages.
        feature: edge features [E, F'].
        state: edge states [E + ROWS, W].
        kept: those for the next layer; the same array, or one of its own.
        sender: [E].
        start: first edge of every receiver [N + 1].
        sending: what messages need of their sender [N + ROWS, W].
        receiving: and of their receiver.
        received: the sums.
        encodes: edge states are made of the features; else they are in `state`.
        keeps: edge states are written to `kept`.
        updates: they are so with the message added.
        low: first receiver.
        high: the one behind the last.
    """
    inputs, width = feature.shape[1], encoder.first.shape[1]
    hidden, other, own, rows = zero_tile(), zero_tile(), zero_tile(), zero_tile()
    ends = np.empty(ROWS, np.int64)
    receiver, last = low, start[high]
    for begin in range(start[low], last, ROWS):
        count = min(ROWS, last - begin)
        if encodes:
            for r in range(count):
                for c in range(inputs):
                    rows[r * STRIDE + c] = feature[begin + r, c]
            fill(hidden, encoder.biases, 0)
            product(hidden, rows, encoder.first, 0, inputs, width)
            hidden, other = _rest(encoder, hidden, other)
            for r in range(count):
                scale = scale_of(encoder, hidden, r)
                for c in range(0, width, LANES):
                    store(own, r * STRIDE + c, normal_form(encoder, hidden, r, c, scale))
        else:
            copy(own, state, begin)
        for r in range(count):
            while start[receiver + 1] <= begin + r:
                receiver += 1
            j, i = sender[begin + r] * width, receiver * width
            ends[r] = i
            for c in range(0, width, LANES):
                store(hidden, r * STRIDE + c, load(sending, j + c) + load(receiving, i + c))
        product(hidden, own, mlp.first, 0, width, width)
        hidden, other = _rest(mlp, hidden, other)
        for r in range(count):
            scale, i = scale_of(mlp, hidden, r), ends[r]
            for c in range(0, width, LANES):
                message = normal_form(mlp, hidden, r, c, scale)
                store(received, i + c, load(received, i + c) + message)
                if keeps:
                    edge = load(own, r * STRIDE + c)
                    store(kept, (begin + r) * width + c, edge + message if updates else edge)


@compiled
def update_nodes(mlp: Weights, node: Array, received: Array, updated: Array, low: int, high: int) -> None:
    """Update node states by what they received, in place or into an array of their own."""
    width = mlp.first.shape[1]
    hidden, other, rows = zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        fill(hidden, mlp.biases, 0)
        copy(rows, received, begin)
        product(hidden, rows, mlp.first, 0, width, width)
        copy(rows, node, begin)
        product(hidden, rows, mlp.first, width * width, width, width)
        hidden, other = _rest(mlp, hidden, other)
        for r in range(count):
            scale = scale_of(mlp, hidden, r)
            for c in range(0, width, LANES):
                place = (begin + r) * width + c
                store(updated, place, load(node, place) + normal_form(mlp, hidden, r, c, scale))


@compiled
def decode(mlp: Weights, node: Array, output: Array, low: int, high: int) -> None:
    """Decode node states into outputs [N, O]."""
    width = mlp.first.shape[1]
    hidden, other, rows = zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        copy(rows, node, begin)
        fill(hidden, mlp.biases, 0)
        product(hidden, rows, mlp.first, 0, width, width)
        hidden, other = _rest(mlp, hidden, other)
        for r in range(count):
            for c in range(output.shape[1]):
                output[begin + r, c] = hidden[r * STRIDE + c]
