"""The network without gradients on a GPU: one kernel per layer for the edges, one for the nodes (Triton).

Product by product, all E edges are read and written as E × L numbers some fifteen times a layer. Here a block of edges
goes through a whole message-passing layer in registers: edge states are read and written once, the ends' parts come
from the cache, and messages are summed in groups that share a receiver, in a fixed order, so that a step gives the same
bits again. Edges of a node to itself are taken for padding and dropped.

The kernels make float32 products on tensor cores as sums of products of halves: a = hi + lo in float16 each, with hi hi
+ hi lo + lo hi accurate to 2⁻²² (Ootomo and Yokota 2022); "tf32" takes hi hi alone, which has TF32's eleven bits.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, cast

import torch
import triton
import triton.language as tl
from torch import Tensor, nn

from gns_pl.nn.stack import LayerStack

GROUP = 8
"""Places of a group, whose edges share their receiver: messages are summed within groups, then groups at nodes."""

EDGES = {"float32": 64, "tf32": 128, "bfloat16": 128}
EDGE_WARPS = {"float32": 4, "tf32": 8, "bfloat16": 8}
STAGES = {"float32": 1, "tf32": 1, "bfloat16": 3}
"""Places and warps of a program, and the blocks whose edges are on their way at a time."""

NODES, NODE_WARPS = 64, 4
"""Nodes and warps of a program."""


@triton.jit
def _matrix(weights, WIDTH: tl.constexpr):  # type: ignore[no-untyped-def]
    return tl.load(weights + tl.arange(0, WIDTH)[:, None] * WIDTH + tl.arange(0, WIDTH)[None, :])


@triton.jit
def _product(a, high, weights, WIDTH: tl.constexpr, PRECISION: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return a [M, L] times weights [L, L] in float32; `high` is what was loaded of them, the rest lies behind it."""
    if PRECISION == "float32":
        low = _matrix(weights + WIDTH * WIDTH, WIDTH)
        a_high = a.to(tl.float16)
        a_low = (a - a_high.to(tl.float32)).to(tl.float16)
        total = tl.dot(a_low, high)
        total = tl.dot(a_high, low, total)
        total = tl.dot(a_high, high, total)
    else:
        total = tl.dot(a.to(high.dtype), high)
    return total


@triton.jit
def _rectified(a):  # type: ignore[no-untyped-def]
    return tl.maximum(a, 0.0, propagate_nan=tl.PropagateNan.ALL)


@triton.jit
def _normalised(a, WIDTH: tl.constexpr, EPSILON: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return rows over their deviation; their means are zero by the weights that made them (`_centred`)."""
    return a * tl.rsqrt(tl.sum(a * a, axis=1) / WIDTH + EPSILON)[:, None]


@triton.jit
def _deeper(  # type: ignore[no-untyped-def]
    hidden, weights, biases, WIDTH: tl.constexpr, DEEPER: tl.constexpr, PARTS: tl.constexpr, EPSILON: tl.constexpr,
    PRECISION: tl.constexpr,
):  # fmt: skip
    """Return what the layers behind a first one make of its output, over its deviation."""
    for layer in tl.static_range(DEEPER):
        here = weights + layer * PARTS * WIDTH * WIDTH
        hidden = _product(_rectified(hidden), _matrix(here, WIDTH), here, WIDTH, PRECISION)
        hidden += tl.load(biases + (layer + 1) * WIDTH + tl.arange(0, WIDTH))[None, :]
    return _normalised(hidden, WIDTH, EPSILON)


@triton.jit
def _pass_messages(  # type: ignore[no-untyped-def]
    feature, state, sender, receiver, sending, receiving, summed, first_group, number, programs,
    encoder_first, encoder_weights, encoder_biases, encoder_norm, first, weights, biases, norm,
    WIDTH: tl.constexpr, BLOCK: tl.constexpr, GROUP: tl.constexpr, DEEPER: tl.constexpr, FEATURES: tl.constexpr,
    ENCODES: tl.constexpr, KEEPS: tl.constexpr, UPDATES: tl.constexpr, PARTS: tl.constexpr, EPSILON: tl.constexpr,
    PRECISION: tl.constexpr, HOISTS: tl.constexpr, STAGES: tl.constexpr,
):  # fmt: skip
    """Pass the messages of blocks of places; `summed` gets them by groups.

    Where `HOISTS`, weights are loaded once and stay in a multiprocessor's own memory for all its blocks.
    """
    GROUPS: tl.constexpr = BLOCK // GROUP
    column = tl.arange(0, WIDTH)
    if HOISTS:
        hoisted = _matrix(first, WIDTH)
        deeper = ()
        for layer in tl.static_range(DEEPER):
            deeper = deeper + (_matrix(weights + layer * PARTS * WIDTH * WIDTH, WIDTH),)  # type: ignore[assignment]  # noqa: RUF005
    blocks = tl.cdiv(tl.load(first_group + number), GROUPS)
    for block in tl.range(tl.program_id(0), blocks, programs, num_stages=STAGES):
        # E × L is more than 2³¹ from 17 million edges on.
        group = (block * GROUPS + tl.arange(0, GROUPS)).to(tl.int64)
        place = (block * BLOCK + tl.arange(0, BLOCK)).to(tl.int64)
        at = place[:, None] * WIDTH + column[None, :]
        source, target = tl.load(sender + place), tl.load(receiver + group)
        full = source >= 0
        if ENCODES:
            own = tl.zeros((BLOCK, WIDTH), tl.float32) + tl.load(encoder_first + FEATURES * WIDTH + column)[None, :]
            for each in tl.static_range(FEATURES):
                value = tl.load(feature + place * FEATURES + each)
                own += value[:, None] * tl.load(encoder_first + each * WIDTH + column)[None, :]
            own = _deeper(own, encoder_weights, encoder_biases, WIDTH, DEEPER, PARTS, EPSILON, PRECISION)
            own = own * tl.load(encoder_norm + column)[None, :] + tl.load(encoder_norm + WIDTH + column)[None, :]
        else:
            own = tl.load(state + at)
        if HOISTS:
            value = _product(own, hoisted, first, WIDTH, PRECISION)
        else:
            value = _product(own, _matrix(first, WIDTH), first, WIDTH, PRECISION)
        sent = tl.load(sending + source[:, None] * WIDTH + column[None, :], mask=full[:, None], other=0.0)
        got = tl.load(receiving + target[:, None] * WIDTH + column[None, :], mask=(target >= 0)[:, None], other=0.0)
        value += sent.to(tl.float32)
        got = tl.broadcast_to(got.to(tl.float32)[:, None, :], (GROUPS, GROUP, WIDTH))
        value += tl.reshape(got, (BLOCK, WIDTH))
        if HOISTS:
            for layer in tl.static_range(DEEPER):
                value = _product(_rectified(value), deeper[layer], weights, WIDTH, PRECISION)
                value += tl.load(biases + (layer + 1) * WIDTH + column)[None, :]
            value = _normalised(value, WIDTH, EPSILON)
        else:
            value = _deeper(value, weights, biases, WIDTH, DEEPER, PARTS, EPSILON, PRECISION)
        gain, shift = tl.load(norm + column)[None, :], tl.load(norm + WIDTH + column)[None, :]
        if KEEPS:
            kept = own.to(tl.float32)
            if UPDATES:
                kept = kept + shift + value * gain
            tl.store(state + at, kept.to(state.dtype.element_ty))
        value = tl.where(full[:, None], value, 0.0)
        total = tl.sum(tl.reshape(value, (GROUPS, GROUP, WIDTH)), axis=1)
        edges = tl.sum(tl.reshape(full.to(tl.float32), (GROUPS, GROUP)), axis=1)
        tl.store(summed + group[:, None] * WIDTH + column[None, :], total * gain + edges[:, None] * shift)


@triton.jit
def _update_nodes(  # type: ignore[no-untyped-def]
    node, summed, first_group, first, weights, biases, norm, next_sender, next_receiver, next_bias,
    sending, receiving, number,
    WIDTH: tl.constexpr, BLOCK: tl.constexpr, DEEPER: tl.constexpr, HANDS_ON: tl.constexpr,
    PARTS: tl.constexpr, EPSILON: tl.constexpr, PRECISION: tl.constexpr,
):  # fmt: skip
    """Update a block of nodes by the sums of its groups, and make of them what the next layer needs."""
    row, column = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.arange(0, WIDTH)
    there = row < number
    begin = tl.load(first_group + row, mask=there, other=0)
    end = tl.load(first_group + row + 1, mask=there, other=0)
    received = tl.zeros((BLOCK, WIDTH), tl.float32)
    group, most = begin.to(tl.int64), tl.max(end - begin, axis=0)
    while most > 0:
        received += tl.load(summed + group[:, None] * WIDTH + column[None, :], mask=(group < end)[:, None], other=0.0)
        group += 1
        most -= 1
    at, inside = row[:, None] * WIDTH + column[None, :], there[:, None]
    state = tl.load(node + at, mask=inside, other=0.0)
    second = first + PARTS * WIDTH * WIDTH
    hidden = _product(received, _matrix(first, WIDTH), first, WIDTH, PRECISION)
    hidden += _product(state, _matrix(second, WIDTH), second, WIDTH, PRECISION)
    hidden += tl.load(biases + column)[None, :]
    hidden = _deeper(hidden, weights, biases, WIDTH, DEEPER, PARTS, EPSILON, PRECISION)
    state += hidden * tl.load(norm + column)[None, :] + tl.load(norm + WIDTH + column)[None, :]
    tl.store(node + at, state, mask=inside)
    if HANDS_ON:
        sent = _product(state, _matrix(next_sender, WIDTH), next_sender, WIDTH, PRECISION)
        tl.store(sending + at, sent.to(sending.dtype.element_ty), mask=inside)
        got = _product(state, _matrix(next_receiver, WIDTH), next_receiver, WIDTH, PRECISION)
        got += tl.load(next_bias + column)[None, :]
        tl.store(receiving + at, got.to(receiving.dtype.element_ty), mask=inside)


@dataclass(frozen=True)
class GroupedEdges:
    """Edges in places: every receiver has whole groups of `GROUP` places, in the order of its edges.

    Attributes:
        sender: of every place, −1 where it is empty [S] int32.
        receiver: of every group, −1 where there is none [S / GROUP] int32.
        first_group: of every node, and the number of groups at the end [N + 1] int32.
        place: of every edge; S for padding [E] int64.
    """

    sender: Tensor
    receiver: Tensor
    first_group: Tensor
    place: Tensor

    @classmethod
    def of(cls, edge_index: Tensor, num_nodes: int, block: int) -> GroupedEdges:
        """Lay edges out; it takes no longer than their number to know, so that a GPU need not be waited for.

        Args:
            edge_index: [2, E] sender and receiver, sorted by receiver; the padding, a node to itself, at the end.
            num_nodes: N.
            block: the number of places is a multiple of this.
        """
        sender, receiver = edge_index
        number, device = len(sender), sender.device
        ends = torch.where(sender == receiver, num_nodes, receiver)  # padding belongs to nobody
        start = torch.searchsorted(ends, torch.arange(num_nodes + 1, device=device))
        groups = (start.diff() + GROUP - 1) // GROUP
        first_group = torch.cat([groups.new_zeros(1), groups.cumsum(0)])
        most = (number + (GROUP - 1) * min(number, num_nodes)) // GROUP
        most = max(1, math.ceil(most * GROUP / block)) * (block // GROUP)
        offset = GROUP * first_group[:-1] - start[:-1]
        inside = receiver.clamp(max=num_nodes - 1)
        place = torch.arange(number, device=device) + offset[inside]
        place = torch.where(ends == num_nodes, GROUP * most, place)
        places = torch.full((GROUP * most + 1,), -1, dtype=torch.int32, device=device)
        places.scatter_(0, place, sender.int())
        rank = torch.arange(most, device=device)
        of_group = torch.searchsorted(first_group[1:], rank, right=True)
        of_group = torch.where(of_group < num_nodes, of_group, -1).int()
        return cls(places[:-1], of_group, first_group.int(), place)


class FusedNetwork:
    """The weights of a network as the kernels want them, and its forward pass.

    Args:
        network: whose weights these are; later changes of them are not seen.
        precision: "float32", "tf32" or "bfloat16", of the products; sums, norms and nodes are float32, and but for
            bfloat16 so is what is kept of edges.
    """

    def __init__(self, network: LayerStack, precision: str) -> None:
        self.network, self.precision = network, precision
        self.layers = network.layers
        self.encoder = self._mlp(network.edge_encoder)
        first = cast(nn.Linear, network.edge_encoder[0])
        self.encoder_first = torch.cat([first.weight.t(), first.bias[None]]).float().contiguous()
        self.messages = [self._mlp(layer.edge_mlp) for layer in self.layers]
        self.updates = [self._mlp(layer.node_mlp) for layer in self.layers]
        self.ends = [(self._parts(layer.sender.weight), self._parts(layer.receiver.weight)) for layer in self.layers]

    def _parts(self, *weights: Tensor) -> Tensor:
        """Return weights [out, in] as [in, out] one behind the other, in the precision's parts."""
        weight = torch.stack([each.detach().t() for each in weights]).float()
        if self.precision == "bfloat16":
            return weight.bfloat16().contiguous()
        high = weight.half()
        if self.precision == "tf32":
            return high.contiguous()
        return torch.stack([high, (weight - high.float()).half()], dim=1).contiguous()

    def _mlp(self, part: nn.Module) -> dict[str, Any]:
        linears = [each for each in part.children() if isinstance(each, nn.Linear)]
        norm = next(each for each in part.children() if isinstance(each, nn.LayerNorm))
        width = linears[0].out_features
        whole = linears[0].in_features % width == 0  # else the few edge features, multiplied in float32
        weights: list[Tensor] = [each.weight for each in linears[1:]]
        biases: list[Tensor] = [each.bias for each in linears]
        # The norm's subtraction of the mean, done once, in the weights of the layer before it.
        weights[-1], biases[-1] = weights[-1] - weights[-1].mean(dim=0), biases[-1] - biases[-1].mean()
        return {
            "first": self._parts(*torch.split(linears[0].weight, width, dim=1)) if whole else None,
            "weights": self._parts(*weights),
            "biases": torch.cat(biases).detach().float(),
            "norm": torch.cat([norm.weight, norm.bias]).detach().float(),
            "epsilon": norm.eps,
            "deeper": len(linears) - 1,
        }

    def __call__(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return the decoded nodes [N, output_width].

        Args:
            node: node features [N, F] float32.
            edge: edge features [E, F'] float32.
            edge_index: [2, E], sorted by receiver.
        """
        with torch.autocast(node.device.type, enabled=False):
            return self._run(node, edge, edge_index)

    def _run(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        network, number = self.network, len(node)
        block = EDGES[self.precision]
        grouped = GroupedEdges.of(edge_index, number, block)
        places, width = len(grouped.sender), cast(nn.Linear, network.decoder[0]).in_features
        feature = edge.new_zeros(places + 1, edge.shape[1]).index_copy_(0, grouped.place, edge)
        node = network.node_encoder(node).contiguous()
        kept = torch.bfloat16 if self.precision == "bfloat16" else torch.float32
        state = node.new_empty(places if len(self.layers) > 1 else 0, width, dtype=kept)
        summed = node.new_empty(places // GROUP, width)
        sending, receiving = (torch.empty_like(node, dtype=kept) for _ in range(2))
        if self.layers:
            first = self.layers[0]
            sending.copy_(first.sender(node))
            receiving.copy_(first.receiver(node) + cast(nn.Linear, first.edge_mlp[0]).bias)
        blocks = places // block
        hoists = self.precision != "float32"
        programs = min(blocks, _multiprocessors(node.device)) if hoists else blocks
        shared = {"WIDTH": width, "PARTS": 1 if hoists else 2, "PRECISION": self.precision}
        for layer, (message, update) in enumerate(zip(self.messages, self.updates, strict=True)):
            last, encodes = layer + 1 == len(self.layers), layer == 0
            _pass_messages[(programs,)](
                feature, state, grouped.sender, grouped.receiver, sending, receiving, summed,
                grouped.first_group, number, programs,
                self.encoder_first, self.encoder["weights"], self.encoder["biases"], self.encoder["norm"],
                message["first"], message["weights"], message["biases"], message["norm"],
                BLOCK=block, GROUP=GROUP, DEEPER=message["deeper"], FEATURES=edge.shape[1], ENCODES=encodes,
                KEEPS=not last and (encodes or not network.static_edges), UPDATES=not network.static_edges,
                EPSILON=message["epsilon"], HOISTS=hoists, STAGES=1 if encodes else STAGES[self.precision],
                num_warps=EDGE_WARPS[self.precision], **shared,
            )  # fmt: skip
            following = min(layer + 1, len(self.layers) - 1)
            to_sender, to_receiver = self.ends[following]
            _update_nodes[(triton.cdiv(number, NODES),)](
                node, summed, grouped.first_group,
                update["first"], update["weights"], update["biases"], update["norm"],
                to_sender, to_receiver, self.messages[following]["biases"], sending, receiving, number,
                BLOCK=NODES, DEEPER=update["deeper"], HANDS_ON=not last,
                EPSILON=update["epsilon"], num_warps=NODE_WARPS, **shared,
            )  # fmt: skip
        return cast(Tensor, network.decoder(node))


@functools.cache
def _multiprocessors(device: torch.device) -> int:
    return torch.cuda.get_device_properties(device).multi_processor_count if device.type == "cuda" else 3
