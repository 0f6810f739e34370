"""The network without gradients on a GPU: one kernel per layer for the edges, one for the nodes (Triton).

Product by product, all E edges are read and written as E × L numbers some fifteen times a layer. Here a block of edges
goes through a whole message-passing layer in registers: edge states are read and written once, the ends' parts come
from the cache, and messages are summed in groups that share a receiver, in a fixed order, so that a step gives the same
bits again. Edges of a node to itself are taken for padding and dropped.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, cast

import torch
import triton
from torch import Tensor, nn

from gns_pl.nn.fused_kernels import pass_messages, update_nodes
from gns_pl.nn.stack import LayerStack

GROUP = 8
"""Places of a group, whose edges share their receiver: messages are summed within groups, then groups at nodes."""

EDGES = {"float32": 64, "tf32": 128, "bfloat16": 128}
EDGE_WARPS = {"float32": 4, "tf32": 8, "bfloat16": 8}
STAGES = {"float32": 1, "tf32": 1, "bfloat16": 3}
"""Places and warps of a program, and the blocks whose edges are on their way at a time."""

NODES, NODE_WARPS = 64, 4
"""Nodes and warps of a program."""


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
            pass_messages[(programs,)](
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
            update_nodes[(triton.cdiv(number, NODES),)](
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
