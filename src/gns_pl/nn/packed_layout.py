"""Where a network's weights lie in the memory that compiled loops read, and where their gradients are found again.

The weights are packed once as numbers 1, 2, …, which says for every place which weight it holds; 0 is padding. With
that a network is packed, and gradients are unpacked, by one look-up each, and not by some hundred small copies.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gns_pl.nn.lanes import BAND, LANES
from gns_pl.nn.passes import Array, Turned, Weights
from gns_pl.nn.stack import LayerStack


def padded_width(width: int) -> int:
    """Return the numbers that a state of a width takes."""
    return -(-width // LANES) * LANES


class Arrays(NamedTuple):
    """What the compiled loops take, or gradients by it: weights of perceptrons, and both ends' of every layer.

    Attributes:
        node_encoder: of features.
        edge_encoder: likewise.
        decoder: of node states.
        messages: of every layer.
        updates: of every layer.
        ends: what messages take of their senders and receivers, of every layer [2, W, W].
    """

    node_encoder: Weights
    edge_encoder: Weights
    decoder: Weights
    messages: list[Weights]
    updates: list[Weights]
    ends: list[Array]


class TurnedArrays(NamedTuple):
    """`Arrays` for the way back: every matrix transposed."""

    node_encoder: Turned
    edge_encoder: Turned
    decoder: Turned
    messages: list[Turned]
    updates: list[Turned]
    ends: list[Array]


class Layout:
    """The packing of a network that `can_pack` takes.

    Attributes:
        width: of the states, L.
        padded: W.
        outputs: O.
        layers: number of layers.
        shapes: of the weights, in the order of `LayerStack.weights`.
        source: which weight every place holds [P].
        place: where every weight is, in that order [weights].
    """

    def __init__(self, network: LayerStack) -> None:
        self.width = cast(nn.Linear, network.decoder[0]).in_features
        self.padded = padded_width(self.width)
        self.outputs = cast(nn.Linear, network.decoder[-1]).out_features
        self.layers = len(network.layers)
        self.shapes = [weight.shape for weight in network.weights()]
        self._numbers: dict[int, NDArray[np.int64]] = {}
        self._before_norms: list[int] = []
        self._order = {id(weight): k for k, weight in enumerate(network.weights())}
        first = 1
        for weight in network.weights():
            self._numbers[id(weight)] = np.arange(first, first + weight.numel()).reshape(weight.shape)
            first += weight.numel()
        self._epsilons = _epsilons(network)
        self._shares: list[Array] = []
        parts = [self._mlp(network.node_encoder, 0), self._mlp(network.edge_encoder, 0), self._mlp(network.decoder, 1)]
        parts += [self._mlp(layer.edge_mlp, 1) for layer in network.layers]
        parts += [self._mlp(layer.node_mlp, 2) for layer in network.layers]
        ends = [
            np.stack([self._square(self._number(end)) for end in (layer.sender.weight, layer.receiver.weight)])
            for layer in network.layers
        ]
        packed = [array for part in parts for array in part] + ends
        self._shapes = [array.shape for array in packed]
        self.source = np.concatenate([array.ravel() for array in packed])
        self.place = np.argsort(self.source, kind="stable")[-(first - 1) :]
        whole = self.cut(np.arange(1, len(self.source) + 1))
        kinds = [0, 0, 1] + [1] * self.layers + [2] * self.layers
        mlps = [*whole[:3], *whole.messages, *whole.updates]
        turned = [array for mlp, kind in zip(mlps, kinds, strict=True) for array in self._turned(mlp, kind)]
        turned += [end.transpose(0, 2, 1) for end in whole.ends]
        self._turned_shapes = [array.shape for array in turned]
        self._turned_source = np.concatenate([array.ravel() for array in turned])
        del self._numbers, self._order

    def fits(self, network: LayerStack) -> bool:
        """Return whether a network is packed so, too."""
        return self.shapes == [weight.shape for weight in network.weights()] and self._epsilons == _epsilons(network)

    def packed(self, weights: list[Tensor]) -> Array:
        """Return the weights packed [P]; the mean that a norm subtracts is taken off the layer before it."""
        given = [weight.detach() for weight in weights]
        for k in self._before_norms:
            given[k] = given[k] - given[k].mean(dim=0)
        flat: Array = torch.cat([given[0].new_zeros(1), *[weight.reshape(-1) for weight in given]]).numpy()[self.source]
        return flat

    def cut(self, flat: NDArray[Any]) -> Arrays:
        """Return the views of memory [P] that the compiled loops take."""
        arrays = _cut(flat, self._shapes)
        first, deeper, biases, norm = (arrays[k : 4 * len(self._shares) : 4] for k in range(4))
        mlps = [Weights(*parts) for parts in zip(first, deeper, biases, norm, self._shares, strict=True)]
        node, edge, decoder, *others = mlps
        return Arrays(node, edge, decoder, others[: self.layers], others[self.layers :], arrays[4 * len(mlps) :])

    def turned(self, flat: Array) -> TurnedArrays:
        """Return what is packed in memory [P] for the way back."""
        arrays = _cut(np.append(np.float32(0), flat)[self._turned_source], self._turned_shapes)
        number = 2 * len(self._shares)
        node, edge, decoder, *others = [
            Turned(*parts) for parts in zip(arrays[:number:2], arrays[1:number:2], strict=True)
        ]
        return TurnedArrays(node, edge, decoder, others[: self.layers], others[self.layers :], arrays[number:])

    def _number(self, weight: Tensor) -> NDArray[np.int64]:
        return self._numbers[id(weight)]

    def _square(self, weight: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return a weight [out, in] transposed and padded [W, W]."""
        square = np.zeros((self.padded, self.padded), np.int64)
        square[: weight.shape[1], : weight.shape[0]] = weight.T
        return square

    def _mlp(self, part: nn.Sequential, parts: int) -> list[NDArray[np.int64]]:
        """Pack a perceptron whose input is so many states one behind the other; 0: features."""
        linears = [each for each in part if isinstance(each, nn.Linear)]
        norm = next((each for each in part if isinstance(each, nn.LayerNorm)), None)
        weights, biases = [self._number(each.weight) for each in linears], [self._number(each.bias) for each in linears]
        if parts:
            first = np.concatenate([self._square(each) for each in np.split(weights[0], parts, axis=1)])
        else:
            first = np.zeros((-(-weights[0].shape[1] // BAND) * BAND, self.padded), np.int64)
            first[: weights[0].shape[1], : self.width] = weights[0].T
        rows, scales = np.zeros((len(biases), self.padded), np.int64), np.zeros((2, self.padded), np.int64)
        for row, bias in zip(rows, biases, strict=True):
            row[: len(bias)] = bias
        if norm is not None:
            scales[:, : self.width] = self._number(norm.weight), self._number(norm.bias)
            self._before_norms += [self._order[id(linears[-1].weight)], self._order[id(linears[-1].bias)]]
        self._shares.append(np.array([1 / self.width, 0.0 if norm is None else norm.eps], np.float32))
        return [first, np.stack([self._square(each) for each in weights[1:]]), rows, scales]

    def _turned(self, mlp: Weights, parts: int) -> tuple[Array, Array]:
        if parts:
            first = mlp.first.reshape(parts, self.padded, self.padded).transpose(0, 2, 1)
        else:
            first = np.zeros((1, self.padded, padded_width(len(mlp.first))), mlp.first.dtype)
            first[0, :, : len(mlp.first)] = mlp.first.T
        return first, mlp.deeper.transpose(0, 2, 1)


def _epsilons(network: LayerStack) -> list[float]:
    """Return what the norms add to variances."""
    parts = [network.node_encoder, network.edge_encoder]
    parts += [part for layer in network.layers for part in (layer.edge_mlp, layer.node_mlp)]
    return [cast(nn.LayerNorm, part[-1]).eps for part in parts]


def _cut(flat: NDArray[Any], shapes: list[tuple[int, ...]]) -> list[Array]:
    """Return arrays of shapes that lie one behind the other."""
    arrays, begin = [], 0
    for shape in shapes:
        size = math.prod(shape)
        arrays.append(flat[begin : begin + size].reshape(shape))
        begin += size
    return arrays
