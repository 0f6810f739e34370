"""Steps of the way back through a perceptron, on a tile of rows that lies in the first cache.

Rows of a tile that stand for no edge or node are zero, so that sums over rows need not know of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.nn.compiled import compiled
from gns_pl.nn.lanes import BAND, LANES, ROWS, STRIDE, add_outer, load, rectify, repeat, store, total, where_positive
from gns_pl.nn.passes import Array, Turned, Weights, copy, fill, product, scale_of


@compiled
def zero_tiles(number: int) -> Array:
    """Return so many tiles of zeros."""
    return np.zeros((number, ROWS * STRIDE), np.float32)


@compiled
def put(rows: Array, begin: int, count: int, tile: Array) -> None:
    """Write some rows of a tile to an array."""
    width = rows.shape[1]
    for r in range(count):
        for c in range(0, width, LANES):
            store(rows, (begin + r) * width + c, load(tile, r * STRIDE + c))


@compiled
def clear(tile: Array, width: int, begin: int) -> None:
    """Put zeros into the rows of a tile from one on."""
    nothing = repeat(np.float32(0))
    for r in range(begin, ROWS):
        for c in range(0, width, LANES):
            store(tile, r * STRIDE + c, nothing)


@compiled
def take(tile: Array, rows: Array, begin: int, count: int) -> None:
    """Put some rows of an array into a tile whose other rows are zero."""
    copy(tile, rows, begin)
    clear(tile, rows.shape[1], count)


@compiled
def make_again(mlp: Weights, tiles: Array, count: int) -> None:
    """Make hidden values [0 … D) and the output before the norm [D] of what the first layer gives, which is in [0]."""
    depth, width = mlp.deeper.shape[0], mlp.deeper.shape[2]
    for d in range(depth):
        hidden, following = tiles[d], tiles[d + 1]
        for r in range(count):
            for c in range(0, width, LANES):
                store(hidden, r * STRIDE + c, rectify(load(hidden, r * STRIDE + c)))
        clear(hidden, width, count)
        fill(following, mlp.biases, d + 1)
        product(following, hidden, mlp.deeper, d * width * width, width, width)


@compiled
def add_sums(sums: Array, row: int, tile: Array) -> None:
    """Add the sum over a tile's rows to a row of an array."""
    width = sums.shape[1]
    for c in range(0, width, LANES):
        value = load(sums, row * width + c)
        for r in range(ROWS):
            value = value + load(tile, r * STRIDE + c)
        store(sums, row * width + c, value)


@compiled
def add_products(into: Array, begin: int, tile: Array, depth: int, above: Array, width: int) -> None:
    """Add to a matrix, which begins at `begin`, the product of a transposed tile with another one."""
    for c in range(0, width, LANES):
        for k in range(0, depth, BAND):
            add_outer(into, begin, width, tile, k, above, c)


@compiled
def through_norm(mlp: Weights, sums: Weights, value: Array, above: Array, given: Array) -> None:
    """Make of the gradient `above`, by a norm's output, that by its input, which is `value` and is normalised here."""
    width = mlp.norm.shape[1]
    for r in range(ROWS):
        scale, along, mean = scale_of(mlp, value, r), repeat(np.float32(0)), repeat(np.float32(0))
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
    add_sums(sums.norm, 1, above)
    for c in range(0, width, LANES):
        weight = load(sums.norm, c)
        for r in range(ROWS):
            weight = weight + load(above, r * STRIDE + c) * load(value, r * STRIDE + c)
        store(sums.norm, c, weight)


@compiled
def to_first(mlp: Weights, turned: Turned, sums: Weights, tiles: Array, above: Array, other: Array) -> Any:
    """Take the gradient by the output before the norm back to the first layer's output; return it and a free tile."""
    depth, width = mlp.deeper.shape[0], mlp.deeper.shape[2]
    for d in range(depth - 1, -1, -1):
        hidden = tiles[d]
        add_sums(sums.biases, d + 1, above)
        add_products(sums.deeper, d * width * width, hidden, width, above, width)
        clear(other, width, 0)
        product(other, above, turned.deeper, d * width * width, width, width)
        for r in range(ROWS):
            for c in range(0, width, LANES):
                place = r * STRIDE + c
                store(other, place, where_positive(load(hidden, place), load(other, place)))
        above, other = other, above
    return above, other


@compiled
def encode_again(mlp: Weights, feature: Array, rows: Array, tiles: Array, begin: int, count: int) -> None:
    """Put features into the tile `rows`, and make of them what `make_again` does."""
    inputs = feature.shape[1]
    if count < ROWS:
        rows[:] = 0
    for r in range(count):
        for c in range(inputs):
            rows[r * STRIDE + c] = feature[begin + r, c]
    fill(tiles[0], mlp.biases, 0)
    product(tiles[0], rows, mlp.first, 0, inputs, mlp.first.shape[1])
    make_again(mlp, tiles, count)


@compiled
def to_features(
    mlp: Weights, turned: Turned, sums: Weights, rows: Array, tiles: Array, above: Array, other: Array,
    to_feature: Array, begin: int, count: int,
) -> None:  # fmt: skip
    """Take the gradient by encoded states back to their features [N, F]."""
    inputs, width, padded = to_feature.shape[1], mlp.first.shape[1], turned.first.shape[2]
    through_norm(mlp, sums, tiles[mlp.deeper.shape[0]], above, other)
    above, other = to_first(mlp, turned, sums, tiles, other, above)
    add_sums(sums.biases, 0, above)
    add_products(sums.first, 0, rows, inputs, above, width)
    clear(other, padded, 0)
    product(other, above, turned.first, 0, width, padded)
    for r in range(count):
        for c in range(inputs):
            to_feature[begin + r, c] = other[r * STRIDE + c]


@compiled
def _settle(part: Array, whole: Array) -> None:
    part, whole = part.reshape(-1), whole.reshape(-1)
    for place in range(len(part)):
        whole[place] += part[place]
        part[place] = 0


@compiled
def settle(part: Weights, whole: Weights) -> None:
    """Add sums to others, and begin anew."""
    _settle(part.first, whole.first)
    _settle(part.deeper, whole.deeper)
    _settle(part.biases, whole.biases)
    _settle(part.norm, whole.norm)
