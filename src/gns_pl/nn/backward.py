"""The way back through `nn.passes`: derivatives of a layer as compiled loops over tiles of edges and of nodes.

A tile is made a second time from the states that its layer was given, since to keep what lies between them would cost
more memory than it saves work; then its gradient goes through norm, products and ReLUs (`nn.tiles_backward`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.nn.compiled import compiled
from gns_pl.nn.lanes import LANES, ROWS, STRIDE, load, store
from gns_pl.nn.passes import Array, Turned, Weights, fill, normal_form, product, scale_of, zero_tile
from gns_pl.nn.tiles_backward import (
    add_products,
    add_sums,
    clear,
    encode_again,
    make_again,
    put,
    settle,
    take,
    through_norm,
    to_features,
    to_first,
    zero_tiles,
)

SETTLED = 64 * ROWS
"""Edges after which sums go to those of all edges: float32 sums of many thousand numbers lose digits."""


@compiled
def messages_backward(
    encoder: Weights, encoder_turned: Turned, encoder_sums: Any, mlp: Weights, turned: Turned, sums: Any,
    feature: Array, state: Array, sender: Any, start: Any, sending: Array, receiving: Array, to_received: Array,
    to_state: Array, to_feature: Array, to_sending: Array, to_receiving: Array, encodes: bool, carries: bool,
    fresh: bool, low: int, high: int,
) -> None:  # fmt: skip
    """Go back through the messages to receivers low … high, in the first layer through the encoder of edges as well.

    Args:
        encoder: of edges.
        encoder_turned: the same transposed.
        encoder_sums: gradients by its weights, of some tiles and of all [2].
        mlp: of messages.
        turned: the same transposed.
        sums: gradients as of the encoder.
        feature: edge features [E, F'].
        state: edge states that the layer was given [E + ROWS, W]; empty where they are made of the features.
        sender: [E].
        start: first edge of every receiver [N + 1].
        sending: what messages need of their sender [N + ROWS, W].
        receiving: and of their receiver.
        to_received: gradient by the sums at receivers [N + ROWS, W].
        to_state: gradient by edge states [E + ROWS, W]; by those the layer returns, and then by those it was given.
        to_feature: gradient by the features, for a layer that encodes [E, F'].
        to_sending: sums to which gradients are added.
        to_receiving: likewise.
        encodes: edge states are made of the features.
        carries: the edge states that the layer returns have a gradient.
        fresh: `to_state` has none yet.
        low: first receiver.
        high: the one behind the last.
    """
    width = encoder.first.shape[1]
    tiles, encoded = zero_tiles(mlp.deeper.shape[0] + 1), zero_tiles(encoder.deeper.shape[0] + 1)
    own, above, other, rows = zero_tile(), zero_tile(), zero_tile(), zero_tile()
    ends = np.empty(ROWS, np.int64)
    receiver, last, settled = low, start[high], start[low]
    for begin in range(start[low], last, ROWS):
        count = min(ROWS, last - begin)
        if encodes:
            encode_again(encoder, feature, rows, encoded, begin, count)
            value = encoded[encoder.deeper.shape[0]]
            for r in range(count):
                scale = scale_of(encoder, value, r)
                for c in range(0, width, LANES):
                    store(own, r * STRIDE + c, normal_form(encoder, value, r, c, scale))
            clear(own, width, count)
        else:
            take(own, state, begin, count)
        hidden = tiles[0]
        for r in range(count):
            while start[receiver + 1] <= begin + r:
                receiver += 1
            j, i = sender[begin + r] * width, receiver * width
            ends[r] = i
            for c in range(0, width, LANES):
                store(hidden, r * STRIDE + c, load(sending, j + c) + load(receiving, i + c))
                given = load(to_received, i + c)
                if carries:
                    given = given + load(to_state, (begin + r) * width + c)
                store(above, r * STRIDE + c, given)
        clear(above, width, count)
        product(hidden, own, mlp.first, 0, width, width)
        make_again(mlp, tiles, count)
        through_norm(mlp, sums[0], tiles[mlp.deeper.shape[0]], above, other)
        above, other = to_first(mlp, turned, sums[0], tiles, other, above)
        add_products(sums[0].first, 0, own, width, above, width)
        for r in range(count):
            j, i = sender[begin + r] * width, ends[r]
            for c in range(0, width, LANES):
                gradient = load(above, r * STRIDE + c)
                store(to_sending, j + c, load(to_sending, j + c) + gradient)
                store(to_receiving, i + c, load(to_receiving, i + c) + gradient)
        if fresh:
            clear(other, width, 0)
        else:
            take(other, to_state, begin, count)
        product(other, above, turned.first, 0, width, width)
        if encodes:
            around = rows, encoded, other, above
            to_features(encoder, encoder_turned, encoder_sums[0], *around, to_feature, begin, count)
        else:
            put(to_state, begin, count, other)
        if begin - settled >= SETTLED:
            settled = begin
            settle(sums[0], sums[1])
            settle(encoder_sums[0], encoder_sums[1])
    settle(sums[0], sums[1])
    settle(encoder_sums[0], encoder_sums[1])


@compiled
def decode_backward(
    mlp: Weights, turned: Turned, sums: Weights, node: Array, to_output: Array, to_node: Array, low: int, high: int
) -> None:
    """Go back through the decoder: of gradients by outputs [N, O] make those by node states [N + ROWS, W]."""
    width, depth = mlp.first.shape[1], mlp.deeper.shape[0]
    tiles, rows, above, other = zero_tiles(depth + 1), zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        take(rows, node, begin, count)
        fill(tiles[0], mlp.biases, 0)
        product(tiles[0], rows, mlp.first, 0, width, width)
        make_again(mlp, tiles, count)
        clear(above, width, 0)
        for r in range(count):
            for c in range(to_output.shape[1]):
                above[r * STRIDE + c] = to_output[begin + r, c]
        above, other = to_first(mlp, turned, sums, tiles, above, other)
        add_sums(sums.biases, 0, above)
        add_products(sums.first, 0, rows, width, above, width)
        clear(other, width, 0)
        product(other, above, turned.first, 0, width, width)
        put(to_node, begin, count, other)


@compiled
def updates_backward(
    mlp: Weights, turned: Turned, sums: Weights, node: Array, received: Array, to_node: Array, to_received: Array,
    low: int, high: int,
) -> None:  # fmt: skip
    """Go back through an update of node states, whose gradients `to_node` are those behind it and then before it."""
    width, depth = mlp.first.shape[1], mlp.deeper.shape[0]
    square = width * width
    tiles, rows, sent, above, other = zero_tiles(depth + 1), zero_tile(), zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        take(rows, node, begin, count)
        take(sent, received, begin, count)
        fill(tiles[0], mlp.biases, 0)
        product(tiles[0], sent, mlp.first, 0, width, width)
        product(tiles[0], rows, mlp.first, square, width, width)
        make_again(mlp, tiles, count)
        take(above, to_node, begin, count)
        through_norm(mlp, sums, tiles[depth], above, other)
        above, other = to_first(mlp, turned, sums, tiles, other, above)
        add_sums(sums.biases, 0, above)
        add_products(sums.first, 0, sent, width, above, width)
        add_products(sums.first, square, rows, width, above, width)
        clear(other, width, 0)
        product(other, above, turned.first, 0, width, width)
        put(to_received, begin, count, other)
        take(other, to_node, begin, count)
        product(other, above, turned.first, square, width, width)
        put(to_node, begin, count, other)


@compiled
def ends_backward(
    turned: Array, sums: Array, biases: Array, node: Array, to_sending: Array, to_receiving: Array, to_node: Array,
    low: int, high: int,
) -> None:  # fmt: skip
    """Go back from what a layer's messages need of both ends to node states, to whose gradients is added."""
    width = turned.shape[1]
    square = width * width
    rows, above, other = zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        take(rows, node, begin, count)
        take(other, to_node, begin, count)
        take(above, to_sending, begin, count)
        add_products(sums, 0, rows, width, above, width)
        product(other, above, turned, 0, width, width)
        take(above, to_receiving, begin, count)
        add_sums(biases, 0, above)
        add_products(sums, square, rows, width, above, width)
        product(other, above, turned, square, width, width)
        put(to_node, begin, count, other)


@compiled
def encode_backward(
    mlp: Weights, turned: Turned, sums: Weights, feature: Array, to_node: Array, to_feature: Array, low: int, high: int
) -> None:
    """Go back through the encoder of nodes to their features [N, F]."""
    tiles, rows, above, other = zero_tiles(mlp.deeper.shape[0] + 1), zero_tile(), zero_tile(), zero_tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        encode_again(mlp, feature, rows, tiles, begin, count)
        take(above, to_node, begin, count)
        to_features(mlp, turned, sums, rows, tiles, above, other, to_feature, begin, count)
