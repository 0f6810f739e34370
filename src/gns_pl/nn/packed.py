"""A network of small width on a CPU: its weights packed once, its pass in a few compiled loops.

With states of 32 numbers and a thousand particles, what stands between the products, and the hundreds of calls that
make them, take longer than the products do. Here a tile of edges, and then of nodes, goes through a whole layer in the
first cache and in registers (`nn.passes`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn

from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.lanes import ROWS, STRIDE
from gns_pl.nn.packed_layout import Layout, TurnedArrays, padded_width
from gns_pl.nn.passes import Array, decode, encode_nodes, hand_on, pass_messages, update_nodes
from gns_pl.nn.sorted_edges import SortedEdges
from gns_pl.nn.stack import LayerStack

ROOM = 1.125
"""A pass takes so many times the memory of its states, so that one with some more edges can use it again."""

SPARE_BYTES = 2**25
"""Memory of a pass that is kept for the next one."""


def can_pack(network: LayerStack) -> bool:
    """Return whether the compiled loops know a network's layers, and are wide enough for it."""
    if any(type(layer) is not InteractionNetwork for layer in network.layers):
        return False
    normed = [network.node_encoder, network.edge_encoder]
    normed += [part for layer in network.layers for part in (layer.edge_mlp, layer.node_mlp)]
    ends = [part for layer in network.layers for part in (layer.sender, layer.receiver)]
    if not (_is_plain(network.decoder, nn.Linear) and all(_is_plain(part, nn.LayerNorm) for part in normed)):
        return False
    width = padded_width(cast(nn.Linear, network.decoder[0]).in_features)
    if len(network.weights()) != sum(len(list(part.parameters())) for part in [*normed, network.decoder, *ends]):
        return False  # it has others besides
    outputs = cast(nn.Linear, network.decoder[-1]).out_features
    inputs = [cast(nn.Linear, part[0]).in_features for part in normed[:2]]
    return max(width, *inputs) <= STRIDE and outputs <= width


def _is_plain(part: nn.Sequential, end: type[nn.Module]) -> bool:
    """Return whether a part has `nn.mlp`'s layers, at least two of them with weights, and ends with a certain one."""
    kinds = [type(layer) for layer in part]
    linears = kinds[:-1] if end is nn.LayerNorm else kinds
    plain = len(linears) > 2 and linears == [nn.Linear, nn.ReLU] * (len(linears) // 2) + [nn.Linear]
    return plain and kinds[-1] is end and all(layer.bias is not None for layer in part if isinstance(layer, nn.Linear))


class States(NamedTuple):
    """Arrays that a pass fills in, in lists over layers.

    Attributes:
        memory: in which they lie [rows, W].
        node: node states that a layer is given, and those behind the last [N + ROWS, W].
        sending: what a layer's messages need of their sender, alike.
        receiving: and of their receiver.
        received: sums of messages.
        edge: edge states that a layer is given [E + ROWS, W]; the first makes them itself.
    """

    memory: Array
    node: list[Array]
    sending: list[Array]
    receiving: list[Array]
    received: list[Array]
    edge: list[Array]


class PackedNetwork:
    """The weights of a network as the compiled loops want them, and its forward pass.

    Args:
        network: that `can_pack` takes; later changes of its weights are not seen.
        before: the same network with other weights, most of the time; what suits is used again.
    """

    def __init__(self, network: LayerStack, before: PackedNetwork | None = None) -> None:
        before = before if before is not None and before.layout.fits(network) else None
        self.layout: Layout = before.layout if before is not None else Layout(network)
        self.static_edges = network.static_edges
        self._flat = self.layout.packed(network.weights())
        self.arrays = self.layout.cut(self._flat)
        self._spare: list[Array] = before._spare if before is not None else []

    @functools.cached_property
    def turned(self) -> TurnedArrays:
        """The weights for the way back."""
        return self.layout.turned(self._flat)

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
        states = self.states(len(node), len(edge), keep=False)
        output = self.passed(node, edge, edges, states, exchange)
        if states.memory.nbytes <= SPARE_BYTES:
            self._spare.append(states.memory)
        return output

    def states(self, nodes: int, edges: int, *, keep: bool) -> States:
        """Return the arrays of a pass.

        Args:
            nodes: N.
            edges: E.
            keep: every layer has arrays of its own; else all have the same, whose memory may be used again.
        """
        layers, width = self.layout.layers, self.layout.padded
        sets = layers if keep else 1
        edge_sets = min(max(layers - 1, 0), 1 if self.static_edges else sets)
        node_rows, edge_rows = (3 * sets + sets + keep) * (nodes + ROWS), edge_sets * (edges + ROWS)
        memory = np.empty((node_rows + edge_rows, width), np.float32) if keep else self._memory(node_rows + edge_rows)
        of_nodes = memory[:node_rows].reshape(-1, nodes + ROWS, width)
        of_edges = memory[node_rows : node_rows + edge_rows].reshape(-1, edges + ROWS, width)
        sending, receiving, received, node = (
            _of_layers(of_nodes[first * sets :][: sets + keep * (first == 3)], layers + 1) for first in range(4)
        )
        edge = [memory[:0], *_of_layers(of_edges, layers)] if edge_sets else [memory[:0]] * (layers + 1)
        return States(memory, node, sending, receiving, received, edge)

    def passed(
        self,
        node: Tensor,
        edge: Tensor,
        edges: SortedEdges,
        states: States,
        exchange: Callable[[Tensor], None] | None = None,
    ) -> Tensor:
        """Return the decoded nodes as `__call__` does, and fill in the states."""
        number, layers, arrays = len(node), self.layout.layers, self.arrays
        features, edge_features = (given.detach().contiguous().numpy() for given in (node, edge))
        output = node.new_empty(number, self.layout.outputs)
        decoded = output.numpy()

        def hand(layer: int, low: int, high: int) -> None:
            if layer == layers:
                decode(arrays.decoder, states.node[layer], decoded, low, high)
            else:
                biases, ends = arrays.messages[layer].biases, (states.sending[layer], states.receiving[layer])
                hand_on(arrays.ends[layer], biases, states.node[layer], *ends, low, high)
                states.received[layer][low:high] = 0

        def encode(low: int, high: int) -> None:
            encode_nodes(arrays.node_encoder, features, states.node[0], low, high)
            hand(0, low, high)

        def update(layer: int, hands: bool, low: int, high: int) -> None:
            before, received, after = states.node[layer], states.received[layer], states.node[layer + 1]
            update_nodes(arrays.updates[layer], before, received, after, low, high)
            if hands:
                hand(layer + 1, low, high)

        edges.share_alike(encode)
        for layer, message in enumerate(arrays.messages):
            last, encodes = layer + 1 == layers, layer == 0
            keeps = not last and (encodes or not self.static_edges)
            of_edges = (
                edge_features,
                states.edge[layer],
                states.edge[layer + 1],
                edges.sender.numpy(),
                edges.start.numpy(),
            )
            ends = (states.sending[layer], states.receiving[layer], states.received[layer])
            settings = (encodes, keeps, not self.static_edges)
            edges.share_alike(pass_messages, arrays.edge_encoder, message, *of_edges, *ends, *settings)
            edges.share_alike(update, layer, exchange is None or last)
            if exchange is not None and not last:
                exchange(torch.from_numpy(states.node[layer + 1])[:number, : self.layout.width])
                edges.share_alike(hand, layer + 1)
        return output

    def _memory(self, rows: int) -> Array:
        """Return rows of states, those of an earlier pass if these are enough: new memory costs time to touch."""
        memory = self._spare.pop() if self._spare else np.zeros((0, self.layout.padded), np.float32)
        return memory if len(memory) >= rows else np.zeros((int(ROOM * rows), self.layout.padded), np.float32)


def _of_layers(arrays: Array, layers: int) -> list[Array]:
    """Return an array for each of so many layers; the last one serves all that are left."""
    return [arrays[min(layer, len(arrays) - 1)] for layer in range(layers)] if len(arrays) else []
