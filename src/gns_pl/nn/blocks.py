"""Message passing without gradients on a CPU, edges in blocks that stay in cache from the first product to the sum.

Layer by layer, every product over all E edges reads and writes E × L numbers: 140 MB for the paper's network and 10,000
particles, which memory delivers at half the speed at which the products could be made. A block of some hundred edges
goes through a whole message instead while it lies in a core's cache; only the edge states come from and go to memory.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from torch import Tensor, nn

from gns_pl.nn.edges import gather_block, norm_block
from gns_pl.nn.sorted_edges import SortedEdges, thread_pool

if TYPE_CHECKING:
    from gns_pl.nn.encode_process_decode import EncodeProcessDecode
    from gns_pl.nn.interaction_network import InteractionNetwork

BLOCK = 1024
"""Edges in a block. On one core, 128 wide, 512 to 4096 took the same time up to 6 %, 128 and 256 a quarter more."""


def process_in_blocks(network: EncodeProcessDecode, node: Tensor, edge: Tensor, edges: SortedEdges) -> Tensor:
    """Return the node states behind all layers [N, L].

    Args:
        network: whose edge encoder and processor are used.
        node: encoded nodes [N, L] float32, on the CPU.
        edge: edge features [E, F'].
        edges: sorted by receiver.
    """
    start = edges.start.numpy()
    wanted = np.searchsorted(start, np.arange(0, len(edge), BLOCK))
    bounds = np.unique(np.concatenate([[0], wanted, [len(node)]])).tolist()
    blocks = [(low, high) for low, high in itertools.pairwise(bounds) if start[low] < start[high]]
    state = node.new_empty(len(edge), node.shape[1])
    encode: Callable[[Tensor], Tensor] | None = network.edge_encoder
    layers = cast("list[InteractionNetwork]", list(network.processor))
    for layer in layers:
        keep = not (network.static_edges or layer is layers[-1])
        received = _pass_messages(layer, node, edge, state, edges, blocks, encode, keep)
        node = node + layer.node_mlp(torch.cat([received, node], dim=1))
        encode = None
    return node


def _pass_messages(
    layer: InteractionNetwork,
    node: Tensor,
    features: Tensor,
    state: Tensor,
    edges: SortedEdges,
    blocks: list[tuple[int, int]],
    encode: Callable[[Tensor], Tensor] | None,
    keep: bool,
) -> Tensor:
    """Return what every node receives [N, L].

    A block's edge states are encoded first where `encode` is given, and updated where they are kept.
    """
    first, norm = cast(nn.Linear, layer.edge_mlp[0]), cast(nn.LayerNorm, layer.edge_mlp[-1])
    linears = [part for part in list(layer.edge_mlp)[1:-1] if isinstance(part, nn.Linear)]
    sending, receiving = layer.sender(node), torch.addmm(first.bias, node, layer.receiver.weight.t())
    received = torch.zeros_like(node)
    sender, start = edges.sender.numpy(), edges.start.numpy()
    ends = sending.numpy(), receiving.numpy()
    weight, bias = norm.weight.detach().numpy(), norm.bias.detach().numpy()
    whole, sums, epsilon = state.numpy(), received.numpy(), np.float32(norm.eps)
    updated = whole if keep else whole[:0]
    size = max((int(start[high] - start[low]) for low, high in blocks), default=0)
    queue, lock, inference = iter(blocks), threading.Lock(), torch.is_inference_mode_enabled()

    def work() -> None:
        one, two = state.new_empty(2, size, state.shape[1])
        inverse = np.empty(size, dtype=np.float32)
        with torch.inference_mode(inference), torch.no_grad():
            for low, high in _taken(queue, lock):
                begin, end = int(start[low]), int(start[high])
                own, hidden, other = state[begin:end], one[: end - begin], two[: end - begin]
                if encode is not None:
                    own.copy_(encode(features[begin:end]))
                torch.mm(own, first.weight.t(), out=hidden)
                gather_block(hidden.numpy(), *ends, sender, start, begin, low, high)
                for linear in linears:
                    torch.addmm(linear.bias, hidden, linear.weight.t(), out=other)
                    if linear is not linears[-1]:
                        other.relu_()
                    hidden, other = other, hidden
                block = hidden.numpy()
                norm_block(block, weight, bias, whole, start, epsilon, inverse, updated, sums, begin, low, high)

    threads = max(1, min(torch.get_num_threads(), len(blocks)))
    for done in [thread_pool(os.getpid()).submit(work) for _ in range(threads)]:
        done.result()
    if layer.averages:
        received /= edges.start.diff().clamp(min=1)[:, None]
    return received


def _taken(queue: Iterator[tuple[int, int]], lock: threading.Lock) -> Iterator[tuple[int, int]]:
    """Yield items of a queue that several threads empty."""
    while True:
        with lock:
            item = next(queue, None)
        if item is None:
            return
        yield item
