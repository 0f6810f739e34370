"""A packed network with derivatives: one operation for autograd, there in `nn.passes`, back in `nn.backward`."""

from __future__ import annotations

import functools
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gns_pl.nn.backward import (
    decode_backward,
    encode_backward,
    ends_backward,
    messages_backward,
    updates_backward,
)
from gns_pl.nn.lanes import ROWS
from gns_pl.nn.packed import PackedNetwork, States
from gns_pl.nn.passes import Array
from gns_pl.nn.sorted_edges import SortedEdges
from gns_pl.nn.stack import LayerStack


def differentiable_pass(
    network: LayerStack, packed: PackedNetwork, node: Tensor, edge: Tensor, edges: SortedEdges
) -> Tensor:
    """Return the decoded nodes [N, output_width] with derivatives by features and weights.

    Args:
        network: whose weights are packed.
        packed: its weights as they are.
        node: node features [N, F] float32, on the CPU.
        edge: edge features [E, F'].
        edges: sorted by receiver.
    """
    return cast(Tensor, _Pass.apply(packed, edges, node, edge, *network.weights()))  # type: ignore[no-untyped-call]


class _Pass(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, packed: PackedNetwork, edges: SortedEdges, node: Tensor, edge: Tensor, *weights: Tensor
    ) -> Tensor:
        ctx.packed, ctx.edges, ctx.states = packed, edges, packed.states(len(node), len(edge), keep=True)
        ctx.sizes, ctx.shapes = [weight.numel() for weight in weights], [weight.shape for weight in weights]
        ctx.save_for_backward(node, edge)
        return packed.passed(node, edge, edges, ctx.states)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor | None, ...]:
        node, edge = ctx.saved_tensors
        layout = ctx.packed.layout
        sums = np.zeros((len(ctx.edges.parts), 2, len(layout.source)), np.float32)
        to_node, to_edge = _go_back(ctx.packed, ctx.edges, ctx.states, sums, node, edge, above)
        found = torch.split(torch.from_numpy(sums.sum(axis=(0, 1))[layout.place]), ctx.sizes)
        gradients = [part.view(shape) for part, shape in zip(found, ctx.shapes, strict=True)]
        return None, None, to_node, to_edge, *gradients


def _go_back(
    packed: PackedNetwork,
    edges: SortedEdges,
    states: States,
    sums: Array,
    node: Tensor,
    edge: Tensor,
    above: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the gradients by node and edge features, and add those by weights to sums, which are a thread's own.

    Args:
        packed: the network.
        edges: sorted by receiver.
        states: of the way there.
        sums: of every part of `edges` [parts, 2, P]: what was summed last, and what before.
        node: node features [N, F].
        edge: edge features [E, F'].
        above: gradient by the outputs [N, O].
    """
    arrays, turned, layers, width = packed.arrays, packed.turned, packed.layout.layers, packed.layout.padded
    features, edge_features, to_output = (given.detach().contiguous().numpy() for given in (node, edge, above))
    to_features, to_edge_features = np.empty_like(features), np.zeros_like(edge_features)
    to_node, to_received, to_receiving = np.empty((3, len(node) + ROWS, width), np.float32)
    to_sending = np.empty((len(sums), len(node) + ROWS, width), np.float32)
    to_state = np.empty((len(edge) + ROWS if layers > 1 else 0, width), np.float32)
    now, whole = ([packed.layout.cut(part[k]) for part in sums] for k in range(2))

    def leave(layer: int, part: int, low: int, high: int) -> None:
        """Go from the node states that a layer is given back to what they are made of."""
        if layer == 0:
            mlp = arrays.node_encoder, turned.node_encoder, now[part].node_encoder
            encode_backward(*mlp, features, to_node, to_features, low, high)
            return
        before = layer - 1
        mlp = arrays.updates[before], turned.updates[before], now[part].updates[before]
        updates_backward(*mlp, states.node[before], states.received[before], to_node, to_received, low, high)
        to_receiving[low:high] = 0
        to_sending[:, low:high] = 0

    def begin(part: int, low: int, high: int) -> None:
        mlp = arrays.decoder, turned.decoder, now[part].decoder
        decode_backward(*mlp, states.node[layers], to_output, to_node, low, high)
        leave(layers, part, low, high)

    def gather(layer: int, part: int, low: int, high: int) -> None:
        for other in to_sending[1:]:
            to_sending[0, low:high] += other[low:high]
        ends = turned.ends[layer], now[part].ends[layer], now[part].messages[layer].biases
        ends_backward(*ends, states.node[layer], to_sending[0], to_receiving, to_node, low, high)
        leave(layer, part, low, high)

    def messages(layer: int, part: int, low: int, high: int) -> None:
        last = layer + 1 == layers
        encoder = arrays.edge_encoder, turned.edge_encoder, (now[part].edge_encoder, whole[part].edge_encoder)
        mlp = arrays.messages[layer], turned.messages[layer], (now[part].messages[layer], whole[part].messages[layer])
        given = edge_features, states.edge[layer], edges.sender.numpy(), edges.start.numpy()
        ends = states.sending[layer], states.receiving[layer]
        gradients = to_received, to_state, to_edge_features, to_sending[part], to_receiving
        settings = layer == 0, not (last or packed.static_edges), last
        messages_backward(*encoder, *mlp, *given, *ends, *gradients, *settings, low, high)

    edges.share(begin, lambda part: [part])
    for layer in reversed(range(layers)):
        edges.share(functools.partial(messages, layer), lambda part: [part])
        edges.share(functools.partial(gather, layer), lambda part: [part])
    return torch.from_numpy(to_features), torch.from_numpy(to_edge_features)
