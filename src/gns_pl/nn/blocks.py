"""The network without gradients on a CPU, in blocks that stay in cache from a message's first product to its sum.

Product by product, all E edges are read and written as E × L numbers: 140 MB for the paper's network and 10,000
particles, which memory delivers at half the speed at which the products could be made. A block of edges goes through a
whole message-passing layer instead while it lies in a core's cache; only the edge states come from and go to memory.
Blocks of nodes follow, whose update and what the next layer needs of them are made in one go.
"""

from __future__ import annotations

import functools
import itertools
import os
import threading
from collections.abc import Callable, Iterator
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gns_pl.nn.edges import gather_block, norm_block
from gns_pl.nn.sorted_edges import SortedEdges, thread_pool
from gns_pl.nn.stack import LayerStack

BLOCK_BYTES = 512 * 1024
"""Size of a block's states; three of them lie in a core's cache at a time."""


def process_in_blocks(network: LayerStack, node: Tensor, edge: Tensor, edges: SortedEdges) -> Tensor:
    """Return what the network makes of features [N, output_width].

    Args:
        network: with at least the node encoder and the decoder.
        node: node features [N, F] float32, on the CPU.
        edge: edge features [E, F'].
        edges: sorted by receiver.
    """
    return _Blocks(network, node, edge, edges).run()


class _Blocks:
    """The arrays of one forward pass; every block of them is worked on by one thread at a time."""

    def __init__(self, network: LayerStack, node: Tensor, edge: Tensor, edges: SortedEdges) -> None:
        self.network, self.edges = network, edges
        self.layers = network.layers
        self.node_features, self.edge_features = node, edge
        width, number = cast(nn.Linear, network.decoder[0]).in_features, len(node)
        self.node = node.new_empty(number, width)
        self.received = node.new_empty(number if self.layers else 0, width)
        self.sending, self.receiving = torch.empty_like(self.received), torch.empty_like(self.received)
        keeps_state = len(self.layers) > 1
        self.state = node.new_empty(len(edge) if keeps_state else 0, width)
        self.output = node.new_empty(number, cast(nn.Linear, network.decoder[-1]).out_features)
        start = edges.start.numpy()
        block = max(1, BLOCK_BYTES // (4 * width))
        self.of_edges = _cut(start, np.searchsorted(start, np.arange(0, len(edge), block)))
        self.of_nodes = _cut(start, np.arange(0, number, block))
        self.most_edges = max((int(start[high] - start[low]) for low, high in self.of_edges), default=0)

    def run(self) -> Tensor:
        """Return the decoded nodes."""
        exchange = self.network.exchange
        self._share(self.of_nodes, self._encode)
        for number in range(len(self.layers)):
            self._share(self.of_edges, functools.partial(self._pass, number), num_buffers=3)
            if exchange is None or number + 1 == len(self.layers):
                self._share(self.of_nodes, functools.partial(self._update, number, hand_on=True))
            else:
                self._share(self.of_nodes, functools.partial(self._update, number, hand_on=False))
                exchange(self.node)
                self._share(self.of_nodes, functools.partial(self._hand_on, number + 1))
        return self.output

    def _share(self, blocks: list[tuple[int, int]], work: Callable[..., None], num_buffers: int = 0) -> None:
        """Do the work on every block, on as many threads as torch has, each with buffers of its own."""
        queue, lock, inference = iter(blocks), threading.Lock(), torch.is_inference_mode_enabled()

        def empty_queue() -> None:
            with torch.inference_mode(inference), torch.no_grad():
                buffers = self.node.new_empty(num_buffers, self.most_edges, self.node.shape[1]).unbind()
                for low, high in _taken(queue, lock):
                    work(low, high, *buffers)

        threads = min(torch.get_num_threads(), len(blocks))
        if threads <= 1:
            empty_queue()
        else:
            for done in [thread_pool(os.getpid()).submit(empty_queue) for _ in range(threads)]:
                done.result()

    def _encode(self, low: int, high: int) -> None:
        """Encode nodes."""
        self.node[low:high] = self.network.node_encoder(self.node_features[low:high])
        self._hand_on(0, low, high)

    def _update(self, number: int, low: int, high: int, *, hand_on: bool) -> None:
        """Update nodes by what layer `number` passed to them."""
        layer, node, received = self.layers[number], self.node[low:high], self.received[low:high]
        node += layer.node_mlp(torch.cat([received, node], dim=1))
        if hand_on:
            self._hand_on(number + 1, low, high)

    def _hand_on(self, number: int, low: int, high: int) -> None:
        """Make of nodes what layer `number` needs of them, or what the decoder gives behind the last."""
        node = self.node[low:high]
        if number == len(self.layers):
            self.output[low:high] = self.network.decoder(node)
            return
        layer = self.layers[number]
        torch.mm(node, layer.sender.weight.t(), out=self.sending[low:high])
        bias = cast(nn.Linear, layer.edge_mlp[0]).bias
        torch.addmm(bias, node, layer.receiver.weight.t(), out=self.receiving[low:high])

    def _pass(self, number: int, low: int, high: int, *buffers: Tensor) -> None:
        """Pass the messages of layer `number` to nodes."""
        layer = self.layers[number]
        first, norm = cast(nn.Linear, layer.edge_mlp[0]), cast(nn.LayerNorm, layer.edge_mlp[-1])
        begin, end = (int(self.edges.start[bound]) for bound in (low, high))
        own, hidden, other = (buffer[: end - begin] for buffer in buffers)
        # Kept edge states have their place in `state`; else they are encoded, used and forgotten.
        keep = number + 1 < len(self.layers) and not self.network.static_edges
        if len(self.state):
            own = self.state[begin:end]
        if number == 0 or not len(self.state):
            own.copy_(self.network.edge_encoder(self.edge_features[begin:end]))
        torch.mm(own, first.weight.t(), out=hidden)
        start, sender = self.edges.start.numpy(), self.edges.sender.numpy()
        ends = self.sending.numpy(), self.receiving.numpy()
        gather_block(hidden.numpy(), *ends, sender, start, begin, low, high)
        linears = [part for part in list(layer.edge_mlp)[1:-1] if isinstance(part, nn.Linear)]
        for linear in linears:
            torch.addmm(linear.bias, hidden, linear.weight.t(), out=other)
            if linear is not linears[-1]:
                other.relu_()
            hidden, other = other, hidden
        self.received[low:high] = 0
        norm_block(
            hidden.numpy(),
            norm.weight.detach().numpy(),
            norm.bias.detach().numpy(),
            start,
            np.float32(norm.eps),
            other.numpy().reshape(-1)[: end - begin],
            own.numpy() if keep else own[:0].numpy(),
            self.received.numpy(),
            begin,
            low,
            high,
        )


def _cut(start: NDArray[np.int64], bounds: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the blocks of receivers between bounds, from the first to the last."""
    return list(itertools.pairwise(np.unique(np.append(bounds, [0, len(start) - 1])).tolist()))


def _taken(queue: Iterator[tuple[int, int]], lock: threading.Lock) -> Iterator[tuple[int, int]]:
    """Yield items of a queue that several threads empty."""
    while True:
        with lock:
            item = next(queue, None)
        if item is None:
            return
        yield item
