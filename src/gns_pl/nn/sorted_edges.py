"""Edges in the order of their receivers, and how threads share them out."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gns_pl.machine import compile_function

LEAST_EDGES = 4000
"""A further thread is not worth its start for fewer edges."""


@compile_function
def _find_starts(receiver: Any, start: Any) -> bool:
    """Fill in the first edge of every receiver, and tell whether edges are sorted by receiver."""
    following = 0
    for e in range(len(receiver)):
        if e and receiver[e] < receiver[e - 1]:
            return False
        while following <= receiver[e]:
            start[following] = e
            following += 1
    start[following:] = len(receiver)
    return True


@dataclass(frozen=True)
class SortedEdges:
    """Edges in the order of their receivers.

    Attributes:
        sender: [E] int64.
        start: first edge of every receiver, and E at the end [N + 1] int64.
        parts: first receiver of every thread and the one after its last, with about as many edges each.
    """

    sender: Tensor
    start: Tensor
    parts: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, edge_index: Tensor, num_nodes: int) -> SortedEdges | None:
        """Return the edges, or None if they are not sorted by receiver.

        Args:
            edge_index: [2, E], sender and receiver.
            num_nodes: N.
        """
        sender, receiver = edge_index
        start = torch.empty(num_nodes + 1, dtype=torch.int64)
        if not _find_starts(receiver.contiguous().numpy(), start.numpy()):
            return None
        threads = max(1, min(torch.get_num_threads(), len(sender) // LEAST_EDGES))
        inner = torch.searchsorted(start, torch.arange(1, threads) * (len(sender) // threads)).tolist()
        return cls(sender.contiguous(), start, tuple(itertools.pairwise([0, *inner, num_nodes])))

    def share(self, loop: Callable[..., None], arguments: Callable[[int], list[Any]]) -> None:
        """Run a compiled loop over the receivers of every part, each in a thread of its own.

        Args:
            loop: called with arguments and the bounds of a part.
            arguments: of a part, by its number.
        """
        pool = thread_pool(os.getpid()) if len(self.parts) > 1 else None
        others = [pool.submit(loop, *arguments(k), *part) for k, part in enumerate(self.parts) if k and pool]
        loop(*arguments(0), *self.parts[0])
        for other in others:
            other.result()

    def share_alike(self, loop: Callable[..., None], *arguments: Any) -> None:
        """Run a loop as `share` does, with the same arguments for every part."""
        self.share(loop, lambda part: list(arguments))


@functools.cache
def thread_pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process, each with one for torch; a child that was forked has none of its parent's.

    Args:
        process: its number, `os.getpid()`.
    """
    return ThreadPoolExecutor(os.cpu_count(), initializer=torch.set_num_threads, initargs=(1,))
