"""The way back through `nn.passes`: derivatives of a layer as compiled loops over tiles of edges and of nodes.

A tile is made a second time from the states that its layer was given, since to keep what lies between them would cost
more memory than it saves work; then its gradient goes through norm, products and ReLUs while all of it lies in the
first cache. Rows of a tile that stand for no edge or node are zero, so that sums over rows need not know of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.nn.compiled import compiled
from gns_pl.nn.lanes import (
    BAND,
    LANES,
    ROWS,
    STRIDE,
    add_outer,
    load,
    rectify,
    repeat,
    store,
    total,
    where_positive,
)
from gns_pl.nn.passes import Array, Turned, Weights, _copy, _fill, _normal, _product, _scale, _tile

SETTLED = 64
"""Tiles of edges after which sums go to those of all edges: float32 sums of many thousand numbers lose digits."""


@compiled
def _tiles(number: int) -> Array:
    return np.zeros((number, ROWS * STRIDE), np.float32)


@compiled
def _clear(tile: Array, width: int, begin: int) -> None:
    """Put zeros into the rows of a tile from one on."""
    nothing = repeat(np.float32(0))
    for r in range(begin, ROWS):
        for c in range(0, width, LANES):
            store(tile, r * STRIDE + c, nothing)


@compiled
def _take(tile: Array, rows: Array, begin: int, count: int) -> None:
    """Put some rows of an array into a tile whose other rows are zero."""
    _copy(tile, rows, begin)
    _clear(tile, rows.shape[1], count)


@compiled
def _again(mlp: Weights, tiles: Array, count: int) -> None:
    """Make hidden values [0 … D) and the output before the norm [D] of what the first layer gives, which is in [0]."""
    depth, width = mlp.deeper.shape[0], mlp.deeper.shape[2]
    for d in range(depth):
        hidden, following = tiles[d], tiles[d + 1]
        for r in range(count):
            for c in range(0, width, LANES):
                store(hidden, r * STRIDE + c, rectify(load(hidden, r * STRIDE + c)))
        _clear(hidden, width, count)
        _fill(following, mlp.biases, d + 1)
        _product(following, hidden, mlp.deeper, d * width * width, width, width)


@compiled
def _add_sums(sums: Array, row: int, tile: Array) -> None:
    """Add the sum over a tile's rows to a row of an array."""
    width = sums.shape[1]
    for c in range(0, width, LANES):
        value = load(sums, row * width + c)
        for r in range(ROWS):
            value = value + load(tile, r * STRIDE + c)
        store(sums, row * width + c, value)


@compiled
def _add_products(into: Array, begin: int, tile: Array, depth: int, above: Array, width: int) -> None:
    """Add to a matrix, which begins at `begin`, the product of a transposed tile with another one."""
    for c in range(0, width, LANES):
        for k in range(0, depth, BAND):
            add_outer(into, begin, width, tile, k, above, c)


@compiled
def _through_norm(mlp: Weights, sums: Weights, value: Array, above: Array, given: Array) -> None:
    """Make of the gradient `above`, by a norm's output, that by its input, which is `value` and is normalised here."""
    width = mlp.norm.shape[1]
    for r in range(ROWS):
        scale, along, mean = _scale(mlp, value, r), repeat(np.float32(0)), repeat(np.float32(0))
        for c in range(0, width, LANES):
            place = r * STRIDE + c
            normal, part = load(value, place) * scale, load(above, place) * load(mlp.norm, c)
            store(value, place, normal)
            along, mean = along + part * normal, mean + part
        along, mean = repeat(-total(along) * mlp.share[0]), repeat(-total(mean) * mlp.share[0])
        for c in range(0, width, LANES):
            place = r * STRIDE + c
            part = load(above, place) * load(mlp.norm, c) + mean
            store(given, place, scale * (part + load(value, place) * along))
    _add_sums(sums.norm, 1, above)
    for c in range(0, width, LANES):
        weight = load(sums.norm, c)
        for r in range(ROWS):
            weight = weight + load(above, r * STRIDE + c) * load(value, r * STRIDE + c)
        store(sums.norm, c, weight)


@compiled
def _to_first(mlp: Weights, turned: Turned, sums: Weights, tiles: Array, above: Array, other: Array) -> Any:
    """Take the gradient by the output before the norm back to the first layer's output; return it and a free tile."""
    depth, width = mlp.deeper.shape[0], mlp.deeper.shape[2]
    for d in range(depth - 1, -1, -1):
        hidden = tiles[d]
        _add_sums(sums.biases, d + 1, above)
        _add_products(sums.deeper, d * width * width, hidden, width, above, width)
        _clear(other, width, 0)
        _product(other, above, turned.deeper, d * width * width, width, width)
        for r in range(ROWS):
            for c in range(0, width, LANES):
                place = r * STRIDE + c
                store(other, place, where_positive(load(hidden, place), load(other, place)))
        above, other = other, above
    return above, other


@compiled
def _settle(part: Array, whole: Array) -> None:
    part, whole = part.reshape(-1), whole.reshape(-1)
    for place in range(len(part)):
        whole[place] += part[place]
        part[place] = 0


@compiled
def _settle_all(part: Weights, whole: Weights) -> None:
    """Add sums to others, and begin anew."""
    _settle(part.first, whole.first)
    _settle(part.deeper, whole.deeper)
    _settle(part.biases, whole.biases)
    _settle(part.norm, whole.norm)


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
    inputs, width = feature.shape[1], encoder.first.shape[1]
    tiles, encoded = _tiles(mlp.deeper.shape[0] + 1), _tiles(encoder.deeper.shape[0] + 1)
    own, above, other, rows = _tile(), _tile(), _tile(), _tile()
    ends = np.empty(ROWS, np.int64)
    receiver, last, tile = low, start[high], 0
    for begin in range(start[low], last, ROWS):
        count = min(ROWS, last - begin)
        if encodes:
            if count < ROWS:
                rows[:] = 0
            for r in range(count):
                for c in range(inputs):
                    rows[r * STRIDE + c] = feature[begin + r, c]
            _fill(encoded[0], encoder.biases, 0)
            _product(encoded[0], rows, encoder.first, 0, inputs, width)
            _again(encoder, encoded, count)
            value = encoded[encoder.deeper.shape[0]]
            for r in range(count):
                scale = _scale(encoder, value, r)
                for c in range(0, width, LANES):
                    store(own, r * STRIDE + c, _normal(encoder, value, r, c, scale))
            _clear(own, width, count)
        else:
            _take(own, state, begin, count)
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
        _clear(above, width, count)
        _product(hidden, own, mlp.first, 0, width, width)
        _again(mlp, tiles, count)
        _through_norm(mlp, sums[0], tiles[mlp.deeper.shape[0]], above, other)
        above, other = _to_first(mlp, turned, sums[0], tiles, other, above)
        _add_products(sums[0].first, 0, own, width, above, width)
        for r in range(count):
            j, i = sender[begin + r] * width, ends[r]
            for c in range(0, width, LANES):
                gradient = load(above, r * STRIDE + c)
                store(to_sending, j + c, load(to_sending, j + c) + gradient)
                store(to_receiving, i + c, load(to_receiving, i + c) + gradient)
        if fresh:
            _clear(other, width, 0)
        else:
            _take(other, to_state, begin, count)
        _product(other, above, turned.first, 0, width, width)
        if encodes:
            _through_norm(encoder, encoder_sums[0], encoded[encoder.deeper.shape[0]], other, above)
            above, other = _to_first(encoder, encoder_turned, encoder_sums[0], encoded, above, other)
            _add_sums(encoder_sums[0].biases, 0, above)
            _add_products(encoder_sums[0].first, 0, rows, inputs, above, width)
            padded = encoder_turned.first.shape[2]
            _clear(other, padded, 0)
            _product(other, above, encoder_turned.first, 0, width, padded)
            for r in range(count):
                for c in range(inputs):
                    to_feature[begin + r, c] = other[r * STRIDE + c]
        else:
            for r in range(count):
                for c in range(0, width, LANES):
                    store(to_state, (begin + r) * width + c, load(other, r * STRIDE + c))
        tile += 1
        if tile % SETTLED == 0:
            _settle_all(sums[0], sums[1])
            _settle_all(encoder_sums[0], encoder_sums[1])
    _settle_all(sums[0], sums[1])
    _settle_all(encoder_sums[0], encoder_sums[1])


@compiled
def decode_backward(
    mlp: Weights, turned: Turned, sums: Weights, node: Array, to_output: Array, to_node: Array, low: int, high: int
) -> None:
    """Go back through the decoder: of gradients by outputs [N, O] make those by node states [N + ROWS, W]."""
    width, depth = mlp.first.shape[1], mlp.deeper.shape[0]
    tiles, rows, above, other = _tiles(depth + 1), _tile(), _tile(), _tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        _take(rows, node, begin, count)
        _fill(tiles[0], mlp.biases, 0)
        _product(tiles[0], rows, mlp.first, 0, width, width)
        _again(mlp, tiles, count)
        _clear(above, width, 0)
        for r in range(count):
            for c in range(to_output.shape[1]):
                above[r * STRIDE + c] = to_output[begin + r, c]
        above, other = _to_first(mlp, turned, sums, tiles, above, other)
        _add_sums(sums.biases, 0, above)
        _add_products(sums.first, 0, rows, width, above, width)
        _clear(other, width, 0)
        _product(other, above, turned.first, 0, width, width)
        for r in range(count):
            for c in range(0, width, LANES):
                store(to_node, (begin + r) * width + c, load(other, r * STRIDE + c))


@compiled
def updates_backward(
    mlp: Weights, turned: Turned, sums: Weights, node: Array, received: Array, to_node: Array, to_received: Array,
    low: int, high: int,
) -> None:  # fmt: skip
    """Go back through an update of node states, whose gradients `to_node` are those behind it and then before it."""
    width, depth = mlp.first.shape[1], mlp.deeper.shape[0]
    square = width * width
    tiles, rows, sent, above, other = _tiles(depth + 1), _tile(), _tile(), _tile(), _tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        _take(rows, node, begin, count)
        _take(sent, received, begin, count)
        _fill(tiles[0], mlp.biases, 0)
        _product(tiles[0], sent, mlp.first, 0, width, width)
        _product(tiles[0], rows, mlp.first, square, width, width)
        _again(mlp, tiles, count)
        _take(above, to_node, begin, count)
        _through_norm(mlp, sums, tiles[depth], above, other)
        above, other = _to_first(mlp, turned, sums, tiles, other, above)
        _add_sums(sums.biases, 0, above)
        _add_products(sums.first, 0, sent, width, above, width)
        _add_products(sums.first, square, rows, width, above, width)
        _clear(other, width, 0)
        _product(other, above, turned.first, 0, width, width)
        for r in range(count):
            for c in range(0, width, LANES):
                store(to_received, (begin + r) * width + c, load(other, r * STRIDE + c))
        _take(other, to_node, begin, count)
        _product(other, above, turned.first, square, width, width)
        for r in range(count):
            for c in range(0, width, LANES):
                store(to_node, (begin + r) * width + c, load(other, r * STRIDE + c))


@compiled
def ends_backward(
    turned: Array, sums: Array, biases: Array, node: Array, to_sending: Array, to_receiving: Array, to_node: Array,
    low: int, high: int,
) -> None:  # fmt: skip
    """Go back from what a layer's messages need of both ends to node states, to whose gradients is added."""
    width = turned.shape[1]
    square = width * width
    rows, above, other = _tile(), _tile(), _tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        _take(rows, node, begin, count)
        _take(other, to_node, begin, count)
        _take(above, to_sending, begin, count)
        _add_products(sums, 0, rows, width, above, width)
        _product(other, above, turned, 0, width, width)
        _take(above, to_receiving, begin, count)
        _add_sums(biases, 0, above)
        _add_products(sums, square, rows, width, above, width)
        _product(other, above, turned, square, width, width)
        for r in range(count):
            for c in range(0, width, LANES):
                store(to_node, (begin + r) * width + c, load(other, r * STRIDE + c))


@compiled
def encode_backward(
    mlp: Weights, turned: Turned, sums: Weights, feature: Array, to_node: Array, to_feature: Array, low: int, high: int
) -> None:
    """Go back through the encoder of nodes to their features [N, F]."""
    inputs, width = feature.shape[1], mlp.first.shape[1]
    depth, padded = mlp.deeper.shape[0], turned.first.shape[2]
    tiles, rows, above, other = _tiles(depth + 1), _tile(), _tile(), _tile()
    for begin in range(low, high, ROWS):
        count = min(ROWS, high - begin)
        if count < ROWS:
            rows[:] = 0
        for r in range(count):
            for c in range(inputs):
                rows[r * STRIDE + c] = feature[begin + r, c]
        _fill(tiles[0], mlp.biases, 0)
        _product(tiles[0], rows, mlp.first, 0, inputs, width)
        _again(mlp, tiles, count)
        _take(above, to_node, begin, count)
        _through_norm(mlp, sums, tiles[depth], above, other)
        above, other = _to_first(mlp, turned, sums, tiles, other, above)
        _add_sums(sums.biases, 0, above)
        _add_products(sums.first, 0, rows, inputs, above, width)
        _clear(other, padded, 0)
        _product(other, above, turned.first, 0, width, padded)
        for r in range(count):
            for c in range(inputs):
                to_feature[begin + r, c] = other[r * STRIDE + c]
