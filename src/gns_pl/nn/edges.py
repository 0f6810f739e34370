"""What every edge goes through, in one pass over memory each: compiled loops for the CPU, with their gradients.

A layer's matrix products are torch's. What stands between them (gather both ends, add, ReLU; norm, residual, sum at the
receiver) takes eight passes over edge-sized arrays in plain torch, and as long as the products do. Here it is one pass
before and one after the products, forward and backward. Edges come sorted by receiver, so sums over a node's edges
read a run of memory and need no atomics: results depend on the input and the number of torch's threads alone, among
which receivers are shared out.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from gns_pl.machine import compile_function
from gns_pl.nn.sorted_edges import SortedEdges

Array = NDArray[np.float32]

F = TypeVar("F", bound=Callable[..., Any])
_compiled: Callable[[F], F] = functools.partial(
    compile_function, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy"
)


@_compiled
def gather_block(
    hidden: Array, sending: Array, receiving: Array, sender: Any, start: Any, offset: int, first: int, last: int
) -> None:
    """Add both ends' parts to a block's hidden values and rectify them; row 0 is edge `offset`."""
    width = hidden.shape[1]
    for i in range(first, last):
        for e in range(start[i], start[i + 1]):
            j, k = sender[e], e - offset
            for c in range(width):
                value = hidden[k, c] + sending[j, c] + receiving[i, c]
                hidden[k, c] = np.float32(0) if value <= 0 else value  # so that NaN stays NaN


@_compiled
def _gather_backward(
    above: Array,
    hidden: Array,
    sender: Any,
    start: Any,
    to_edge: Array,
    to_receiving: Array,
    to_sending: Array,
    first: int,
    last: int,
) -> None:
    width = hidden.shape[1]
    for i in range(first, last):
        for e in range(start[i], start[i + 1]):
            j = sender[e]
            for c in range(width):
                gradient = above[e, c] if hidden[e, c] > 0 else np.float32(0)
                to_edge[e, c] = gradient
                to_sending[j, c] += gradient
                to_receiving[i, c] += gradient


@_compiled
def norm_block(
    value: Array,
    weight: Array,
    bias: Array,
    start: Any,
    epsilon: Any,
    inverse: Array,
    updated: Array,
    received: Array,
    offset: int,
    first: int,
    last: int,
) -> None:
    """Turn a block's values into their normalised form in place; row 0 of a block's arrays is edge `offset`.

    Fill 1 / deviation, and add the messages to the sums at their receivers and, unless it is empty, to `updated`. It
    holds the edge states when this begins: read from an array of their own, which might be the same, they would keep
    the compiler from vectorising.
    """
    width = value.shape[1]
    keep = updated.shape[0] > 0
    for i in range(first, last):
        for e in range(start[i], start[i + 1]):
            k = e - offset
            total, square = np.float32(0), np.float32(0)
            for c in range(width):
                total += value[k, c]
            mean = total / np.float32(width)
            for c in range(width):
                square += (value[k, c] - mean) ** 2
            scale = np.float32(1) / np.sqrt(square / np.float32(width) + epsilon)
            inverse[k] = scale
            if keep:
                for c in range(width):
                    normal = (value[k, c] - mean) * scale
                    message = normal * weight[c] + bias[c]
                    value[k, c] = normal
                    updated[k, c] += message
                    received[i, c] += message
            else:
                for c in range(width):
                    normal = (value[k, c] - mean) * scale
                    value[k, c] = normal
                    received[i, c] += normal * weight[c] + bias[c]


@_compiled
def _norm_backward(
    to_updated: Array,
    to_received: Array,
    normal: Array,
    inverse: Array,
    weight: Array,
    start: Any,
    to_value: Array,
    to_weight: Array,
    to_bias: Array,
    first: int,
    last: int,
) -> None:
    width = normal.shape[1]
    share = np.float32(1) / np.float32(width)
    has_edges = to_updated.shape[0] > 0
    above = np.empty(width, dtype=np.float32)
    # Sums over the edges of one node first: float32 sums over all edges would lose digits.
    node_weight, node_bias = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    for i in range(first, last):
        node_weight[:] = 0
        node_bias[:] = 0
        for e in range(start[i], start[i + 1]):
            for c in range(width):
                above[c] = to_received[i, c]
            if has_edges:
                for c in range(width):
                    above[c] += to_updated[e, c]
            mean, along = np.float32(0), np.float32(0)
            for c in range(width):
                gradient = above[c] * weight[c]
                mean += gradient
                along += gradient * normal[e, c]
            mean *= share
            along *= share
            for c in range(width):
                to_value[e, c] = inverse[e] * (above[c] * weight[c] - mean - normal[e, c] * along)
                node_weight[c] += above[c] * normal[e, c]
                node_bias[c] += above[c]
        for c in range(width):
            to_weight[c] += node_weight[c]
            to_bias[c] += node_bias[c]


class _Gather(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, edge: Tensor, sending: Tensor, receiving: Tensor, edges: SortedEdges) -> Tensor:
        ctx.mark_dirty(edge)
        arrays = _arrays(edge, sending, receiving, edges.sender, edges.start)
        edges.share(gather_block, lambda part: [*arrays, 0])
        ctx.save_for_backward(edge)
        ctx.edges = edges
        return edge

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        (hidden,) = ctx.saved_tensors
        edges: SortedEdges = ctx.edges
        to_edge = torch.empty_like(hidden)
        # A sender's edges lie in several parts, so each part has sums of its own.
        to_sending = hidden.new_zeros(len(edges.parts), len(edges.start) - 1, hidden.shape[1])
        to_receiving = torch.zeros_like(to_sending[0])
        arrays = _arrays(above.contiguous(), hidden, edges.sender, edges.start, to_edge, to_receiving)
        edges.share(_gather_backward, lambda part: [*arrays, *_arrays(to_sending[part])])
        return to_edge, to_sending.sum(dim=0), to_receiving, None


class _NormAndSum(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        value: Tensor,
        weight: Tensor,
        bias: Tensor,
        epsilon: float,
        edge: Tensor,
        edges: SortedEdges,
        keep: bool,
    ) -> tuple[Tensor, Tensor]:
        # The products before do not need their own output for their gradient, so the norm is made in place of it.
        normal = value.detach()
        inverse = normal.new_empty(len(normal))
        updated = edge.clone() if keep else normal.new_empty(0, normal.shape[1])
        received = normal.new_zeros(len(edges.start) - 1, normal.shape[1])
        before = _arrays(normal, weight, bias, edges.start)
        behind = _arrays(inverse, updated, received)
        edges.share(norm_block, lambda part: [*before, np.float32(epsilon), *behind, 0])
        ctx.save_for_backward(normal, inverse, weight)
        ctx.edges, ctx.keep = edges, keep
        return updated, received

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_updated: Tensor, to_received: Tensor) -> tuple[Tensor | None, ...]:
        normal, inverse, weight = ctx.saved_tensors
        to_value = torch.empty_like(normal)
        to_weight, to_bias = weight.new_zeros(2, len(ctx.edges.parts), len(weight))
        saved = to_updated.contiguous() if ctx.keep else normal.new_empty(0, normal.shape[1])
        arrays = _arrays(saved, to_received.contiguous(), normal, inverse, weight, ctx.edges.start, to_value)
        ctx.edges.share(_norm_backward, lambda part: [*arrays, *_arrays(to_weight[part], to_bias[part])])
        return to_value, to_weight.sum(dim=0), to_bias.sum(dim=0), None, to_updated if ctx.keep else None, None, None


def _arrays(*tensors: Tensor) -> list[NDArray[Any]]:
    return [tensor.detach().numpy() for tensor in tensors]


def gather_and_rectify(edge: Tensor, sending: Tensor, receiving: Tensor, edges: SortedEdges) -> Tensor:
    """Return relu(edge + sending[sender] + receiving[receiver]) [E, L]; `edge` is overwritten.

    Args:
        edge: a product's output, which nobody else needs [E, L] float32, on the CPU.
        sending: [N, L].
        receiving: [N, L].
        edges: sorted by receiver.
    """
    result: Tensor = _Gather.apply(edge, sending.contiguous(), receiving.contiguous(), edges)  # type: ignore[no-untyped-call]
    return result


def norm_and_sum(
    value: Tensor, norm: torch.nn.LayerNorm, edge: Tensor, edges: SortedEdges, *, keep: bool
) -> tuple[Tensor, Tensor]:
    """Return edge + m [E, L] and Σ m over the edges of every receiver [N, L], where m = norm(value).

    Args:
        value: a product's output, which nobody else needs; overwritten [E, L] float32, on the CPU.
        norm: over L.
        edge: edge states [E, L].
        edges: sorted by receiver.
        keep: whether the new edge states are wanted; else an empty tensor comes in their place.
    """
    result: tuple[Tensor, Tensor] = _NormAndSum.apply(
        value, norm.weight, norm.bias, norm.eps, edge.contiguous(), edges, keep
    )  # type: ignore[no-untyped-call]
    return result
