"""A network of small width on a CPU without gradients: its weights packed once, its pass in a few compiled loops.

With states of 32 numbers and a thousand particles, what stands between the products, and the hundreds of calls that
make them, take longer than the products do. Here a tile of edges, and then of nodes, goes through a whole layer in the
first cache and in registers (`nn.passes`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.lanes import LANES, ROWS, STRIDE
from gns_pl.nn.passes import Array, Weights, decode, encode_nodes, hand_on, pass_messages, update_nodes
from gns_pl.nn.sorted_edges import SortedEdges
from gns_pl.nn.stack import LayerStack

ROOM = 1.125
"""A pass takes so many times the memory of its states, so that one with some more edges can use it again."""

SPARE_BYTES = 2**25
"""Memory of a pass that is kept for the next one."""


def padded_width(width: int) -> int:
    """Return the numbers that a state of a width takes."""
    return -(-width // LANES) * LANES


def can_pack(network: LayerStack) -> bool:
    """Return whether the compiled loops know a network's layers, and are wide enough for it."""
    if any(type(layer) is not InteractionNetwork for layer in network.layers):
        return False
    normed = [network.node_encoder, network.edge_encoder]
    normed += [part for layer in network.layers for part in (layer.edge_mlp, layer.node_mlp)]
    if not (_is_plain(network.decoder, nn.Linear) and all(_is_plain(part, nn.LayerNorm) for part in normed)):
        return False
    width = padded_width(cast(nn.Linear, network.decoder[0]).in_features)
    outputs = cast(nn.Linear, network.decoder[-1]).out_features
    inputs = [cast(nn.Linear, part[0]).in_features for part in normed[:2]]
    return max(width, *inputs) <= STRIDE and outputs <= width


def _is_plain(part: nn.Sequential, end: type[nn.Module]) -> bool:
    """Return whether a part has `nn.mlp`'s layers, at least two of them with weights, and ends with a certain one."""
    kinds = [type(layer) for layer in part]
    linears = kinds[:-1] if end is nn.LayerNorm else kinds
    plain = len(linears) > 2 and linears == [nn.Linear, nn.ReLU] * (len(linears) // 2) + [nn.Linear]
    return plain and kinds[-1] is end and all(layer.bias is not None for layer in part if isinstance(layer, nn.Linear))


class PackedNetwork:
    """The weights of a network as the compiled loops want them, and its forward pass.

    Args:
        network: that `can_pack` takes; later changes of its weights are not seen.
    """

    def __init__(self, network: LayerStack) -> None:
        self.width = cast(nn.Linear, network.decoder[0]).in_features
        self.padded = padded_width(self.width)
        self.outputs = cast(nn.Linear, network.decoder[-1]).out_features
        self.static_edges = network.static_edges
        self.node_encoder, self.edge_encoder = self._mlp(network.node_encoder, 0), self._mlp(network.edge_encoder, 0)
        self.decoder = self._mlp(network.decoder, 1)
        self.messages = [self._mlp(layer.edge_mlp, 1) for layer in network.layers]
        self.updates = [self._mlp(layer.node_mlp, 2) for layer in network.layers]
        self.ends = [
            np.stack([self._square(layer.sender.weight), self._square(layer.receiver.weight)])
            for layer in network.layers
        ]
        self._spare: list[Array] = []

    def _square(self, weight: Tensor) -> Array:
        """Return a weight [out, in] transposed and padded [W, W]."""
        square = np.zeros((self.padded, self.padded), np.float32)
        square[: weight.shape[1], : weight.shape[0]] = weight.detach().t().numpy()
        return square

    def _mlp(self, part: nn.Sequential, parts: int) -> Weights:
        """Pack a perceptron whose input is so many states one behind the other; 0: features."""
        linears = [each for each in part if isinstance(each, nn.Linear)]
        norm = next((each for each in part if isinstance(each, nn.LayerNorm)), None)
        weights, biases = [each.weight.detach() for each in linears], [each.bias.detach() for each in linears]
        if norm is not None:
            weights[-1], biases[-1] = weights[-1] - weights[-1].mean(dim=0), biases[-1] - biases[-1].mean()
        if parts:
            first = np.concatenate([self._square(each) for each in torch.chunk(weights[0], parts, dim=1)])
        else:
            first = np.zeros((weights[0].shape[1], self.padded), np.float32)
            first[:, : self.width] = weights[0].t().numpy()
        deeper = np.stack([self._square(each) for each in weights[1:]])
        rows = np.zeros((len(biases), self.padded), np.float32)
        for row, bias in zip(rows, biases, strict=True):
            row[: len(bias)] = bias.numpy()
        scales = np.zeros((2, self.padded), np.float32)
        if norm is not None:
            scales[:, : self.width] = torch.stack([norm.weight.detach(), norm.bias.detach()]).numpy()
        share = np.array([1 / self.width, 0.0 if norm is None else norm.eps], np.float32)
        return Weights(first, deeper, rows, scales, share)

    def __call__(
        self, node: Tensor, edge: Tensor, edges: SortedEdges, exchange: Callable[[Tensor], None] | None = None
    ) -> Tensor:
        """Return the decoded nodes [N, output_width].

        Args:
            node: node features [N, F] float32, on the CPU.
            edge: edge features [E, F'].
            edges: sorted by receiver.
            exchange: as of `Network`.
        """
        number, layers, width = len(node), len(self.messages), self.padded
        features, edge_features = (given.detach().contiguous().numpy() for given in (node, edge))
        keeps_state = layers > 1
        rows = 4 * (number + ROWS) + (len(edge) + ROWS) * keeps_state
        memory = self._memory(rows)
        states, sending, receiving, received = memory[: 4 * (number + ROWS)].reshape(4, number + ROWS, width)
        state = memory[4 * (number + ROWS) : rows]
        output = node.new_empty(number, self.outputs)
        decoded = output.numpy()

        def hand(layer: int, low: int, high: int) -> None:
            if layer == layers:
                decode(self.decoder, states, decoded, low, high)
            else:
                biases = self.messages[layer].biases
                hand_on(self.ends[layer], biases, states, sending, receiving, low, high)
                received[low:high] = 0

        def encode(low: int, high: int) -> None:
            encode_nodes(self.node_encoder, features, states, low, high)
            hand(0, low, high)

        def update(layer: int, hands: bool, low: int, high: int) -> None:
            update_nodes(self.updates[layer], states, received, low, high)
            if hands:
                hand(layer + 1, low, high)

        edges.share_alike(encode)
        for layer, message in enumerate(self.messages):
            last, encodes = layer + 1 == layers, layer == 0
            keeps = keeps_state and (encodes or not (last or self.static_edges))
            settings = (encodes, keeps, not self.static_edges)
            arrays = (edge_features, state, edges.sender.numpy(), edges.start.numpy(), sending, receiving, received)
            edges.share_alike(pass_messages, self.edge_encoder, message, *arrays, *settings)
            edges.share_alike(update, layer, exchange is None or last)
            if exchange is not None and not last:
                exchange(torch.from_numpy(states)[:number, : self.width])
                edges.share_alike(hand, layer + 1)
        if memory.nbytes <= SPARE_BYTES:
            self._spare.append(memory)
        return output

    def _memory(self, rows: int) -> Array:
        """Return rows of states, those of an earlier pass if these are enough: new memory costs time to touch."""
        memory = self._spare.pop() if self._spare else np.zeros((0, self.padded), np.float32)
        return memory if len(memory) >= rows else np.zeros((int(ROOM * rows), self.padded), np.float32)
