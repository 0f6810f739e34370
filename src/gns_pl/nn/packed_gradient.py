"""A packed network with derivatives: one operation for autograd, there in `nn.passes`, back in `nn.backward`."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from gns_pl.nn.backward import (
    Turned,
    decode_backward,
    encode_backward,
    ends_backward,
    messages_backward,
    updates_backward,
)
from gns_pl.nn.lanes import BAND, LANES, ROWS
from gns_pl.nn.packed import PackedNetwork, States, padded_width
from gns_pl.nn.passes import Array, Weights
from gns_pl.nn.sorted_edges import SortedEdges
from gns_pl.nn.stack import LayerStack


def differentiable_pass(network: LayerStack, packed: PackedNetwork, node: Tensor, edge: Tensor, edges: SortedEdges) -> Tensor:
    """Return the decoded nodes [N, output_width] with derivatives by features and weights.

    Args:
        network: whose weights are packed.
        packed: its weights as they are.
        node: node features [N, F] float32, on the CPU.
        edge: edge features [E, F'].
        edges: sorted by receiver.
    """
    weights = [weight for part in _parts(network) for weight in part.parameters()]
    return cast(Tensor, _Pass.apply(packed, edges, node, edge, *weights))  # type: ignore[no-untyped-call]


def _parts(network: LayerStack) -> list[nn.Module]:
    """Return what has weights, in the order in which `_Sums` has their gradients."""
    layers = [[layer.sender, layer.receiver, layer.edge_mlp, layer.node_mlp] for layer in network.layers]
    return [network.node_encoder, network.edge_encoder, network.decoder, *(part for parts in layers for part in parts)]


class _Pass(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, packed: PackedNetwork, edges: SortedEdges, node: Tensor, edge: Tensor, *weights: Tensor
    ) -> Tensor:
        ctx.packed, ctx.edges, ctx.states = packed, edges, packed.states(len(node), len(edge), keep=True)
        ctx.save_for_backward(node, edge)
        return packed.passed(node, edge, edges, ctx.states)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor | None, ...]:
        node, edge = ctx.saved_tensors
        sums = [_Sums(ctx.packed) for _ in ctx.edges.parts]
        to_node, to_edge = _go_back(ctx.packed, ctx.edges, ctx.states, sums, node, edge, above)
        for other in sums[1:]:
            for total, part in zip(sums[0].arrays, other.arrays, strict=True):
                total += part
        return None, None, to_node, to_edge, *sums[0].by_weights()


class _Sums:
    """Gradients by the weights of a packed network, of what one thread has seen."""

    def __init__(self, packed: PackedNetwork) -> None:
        self.arrays: list[Array] = []
        self._packed = packed
        self.node_encoder, self.decoder = self._like(packed.node_encoder), self._like(packed.decoder)
        self.edge_encoder = self._like(packed.edge_encoder), self._like(packed.edge_encoder)
        self.messages = [(self._like(mlp), self._like(mlp)) for mlp in packed.messages]
        self.updates = [self._like(mlp) for mlp in packed.updates]
        self.ends = [self._zeros(ends.shape) for ends in packed.ends]

    def _zeros(self, shape: tuple[int, ...]) -> Array:
        self.arrays.append(np.zeros(shape, np.float32))
        return self.arrays[-1]

    def _like(self, mlp: Weights) -> Weights:
        rows, width = mlp.first.shape
        first = self._zeros((-(-rows // BAND) * BAND, width))
        return Weights(first, *(self._zeros(part.shape) for part in mlp[1:]))

    def by_weights(self) -> list[Tensor]:
        """Return the gradients in the order of `_parts`."""
        packed = self._packed
        gradients = self._of(self.node_encoder, packed.node_encoder, 0)
        gradients += self._of(self.edge_encoder[1], packed.edge_encoder, 0)
        gradients += self._of(self.decoder, packed.decoder, 1, outputs=packed.outputs)
        for ends, (_, messages), updates, message, update in zip(
            self.ends, self.messages, self.updates, packed.messages, packed.updates, strict=True
        ):
            gradients += torch.from_numpy(ends)[:, : packed.width, : packed.width].transpose(1, 2).unbind()
            gradients += self._of(messages, message, 1) + self._of(updates, update, 2)
        return gradients

    def _of(self, sums: Weights, mlp: Weights, parts: int, outputs: int | None = None) -> list[Tensor]:
        """Return the gradients of a perceptron, as `PackedNetwork` packs it; one without a norm has `outputs`."""
        width, padded = self._packed.width, self._packed.padded
        first, deeper, biases, norm = map(torch.from_numpy, sums[:4])
        if parts:
            first = first.view(parts, padded, padded)[:, :width, :width].permute(2, 0, 1).flatten(1)
        else:
            first = first[: len(mlp.first), :width].t()
        last = width if outputs is None else outputs
        wide = [width] * (len(deeper) - 1) + [last]
        gradients = [first, biases[0, :width]]
        for weight, bias, out in zip(deeper, biases[1:], wide, strict=True):
            gradients += [weight[:width, :out].t(), bias[:out]]
        if outputs is None:  # a norm's mean was taken off the layer before it
            gradients[-2:] = [gradient - gradient.mean(dim=0) for gradient in gradients[-2:]]
            gradients += norm[:, :width].unbind()
        return gradients


def _turned(mlp: Weights, parts: int) -> Turned:
    """Return the matrices of a perceptron transposed; `parts` as of `PackedNetwork`."""
    inputs, width = mlp.first.shape
    if parts:
        first = mlp.first.reshape(parts, width, width).transpose(0, 2, 1)
    else:
        first = np.zeros((1, width, padded_width(inputs)), np.float32)
        first[0, :, :inputs] = mlp.first.T
    return Turned(np.ascontiguousarray(first), np.ascontiguousarray(mlp.deeper.transpose(0, 2, 1)))


def _go_back(
    packed: PackedNetwork,
    edges: SortedEdges,
    states: States,
    sums: list[_Sums],
    node: Tensor,
    edge: Tensor,
    above: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the gradients by node and edge features, and add those by weights to sums, of a thread each.

    Args:
        packed: the network.
        edges: sorted by receiver.
        states: of the way there.
        sums: of every part of `edges`.
        node: node features [N, F].
        edge: edge features [E, F'].
        above: gradient by the outputs [N, O].
    """
    layers, number = len(packed.messages), len(node)
    features, edge_features, to_output = (given.detach().contiguous().numpy() for given in (node, edge, above))
    to_features, to_edge_features = np.empty_like(features), np.zeros_like(edge_features)
    to_node, to_received, to_receiving = np.empty((3, number + ROWS, packed.padded), np.float32)
    to_sending = np.empty((len(sums), number + ROWS, packed.padded), np.float32)
    to_state = np.empty((len(edge) + ROWS if layers > 1 else 0, packed.padded), np.float32)
    encoder, edge_encoder = _turned(packed.node_encoder, 0), _turned(packed.edge_encoder, 0)
    decoder = _turned(packed.decoder, 1)
    messages = [_turned(mlp, 1) for mlp in packed.messages]
    updates = [_turned(mlp, 2) for mlp in packed.updates]
    ends = [np.ascontiguousarray(each.transpose(0, 2, 1)) for each in packed.ends]

    def leave(layer: int, part: int, low: int, high: int) -> None:
        """Go from node states behind a layer back to what they are made of."""
        if layer == 0:
            arrays = features, to_node, to_features
            encode_backward(packed.node_encoder, encoder, sums[part].node_encoder, *arrays, low, high)
            return
        mlp, turned = packed.updates[layer - 1], updates[layer - 1]
        arrays = states.node[layer - 1], states.received[layer - 1], to_node, to_received
        updates_backward(mlp, turned, sums[part].updates[layer - 1], *arrays, low, high)
        to_receiving[low:high] = 0
        to_sending[:, low:high] = 0

    def begin(part: int, low: int, high: int) -> None:
        arrays = states.node[layers], to_output, to_node
        decode_backward(packed.decoder, decoder, sums[part].decoder, *arrays, low, high)
        leave(layers, part, low, high)

    def gather(layer: int, part: int, low: int, high: int) -> None:
        for other in to_sending[1:]:
            to_sending[0, low:high] += other[low:high]
        own = sums[part].ends[layer], sums[part].messages[layer][1].biases
        arrays = states.node[layer], to_sending[0], to_receiving, to_node
        ends_backward(ends[layer], *own, *arrays, low, high)
        leave(layer, part, low, high)

    edges.share(begin, lambda part: [part])
    sender, start = edges.sender.numpy(), edges.start.numpy()
    for layer in reversed(range(layers)):
        last, encodes = layer + 1 == layers, layer == 0
        settings = encodes, not (last or packed.static_edges), last
        arrays = (edge_features, states.edge[layer], sender, start, states.sending[layer], states.receiving[layer])
        gradients = to_received, to_state, to_edge_features
        def given(part):
            encoder = packed.edge_encoder, edge_encoder, sums[part].edge_encoder
            mlp = packed.messages[layer], messages[layer], sums[part].messages[layer]
            return [*encoder, *mlp, *arrays, *gradients, to_sending[part], to_receiving, *settings]
        edges.share(messages_backward, given)
        edges.share(gather, lambda part: [layer, part])
    return torch.from_numpy(to_features), torch.from_numpy(to_edge_features)
