"""Where the network itself led the windows of a training, kept from one visit to the next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

from gns_pl.graph import Static

LARGEST_ERROR = 0.3
"""A window whose root mean square position error is larger is not carried on, but taken up from the truth again
[spacings]. Early in a training that ends most windows after a visit or two, so that what is carried on grows longer as
the network gets better; no schedule is needed."""


class CarriedHistories:
    """Histories by the number of their window (`data.sampler`), each once put there and once taken.

    Every process holds those of its own windows; a checkpoint holds all.
    """

    def __init__(self) -> None:
        self._histories: dict[int, Tensor] = {}

    def take(self, number: Tensor, visit: Tensor, history: Tensor, static: Static) -> tuple[Tensor, Tensor]:
        """Put what was carried in the place of the true histories.

        Args:
            number: of every window [B].
            visit: of every window [B]; at visit 0 nothing was carried.
            history: true positions [N, H, D] [m].
            static: the windows.

        Returns:
            Histories [N, H, D], and which windows were carried [B] bool.
        """
        history = history.clone()
        carried = torch.zeros_like(number, dtype=torch.bool)
        for graph, (key, times) in enumerate(zip(number.tolist(), visit.tolist(), strict=True)):
            kept = self._histories.pop(key, None) if times else None
            if kept is not None:
                history[static.batch == graph] = kept.to(history)
                carried[graph] = True
        return history, carried

    def keep(self, number: Tensor, again: Tensor, history: Tensor, error: Tensor, static: Static) -> None:
        """Keep the histories of the windows that are visited again and whose error is not too large.

        Args:
            number: of every window [B].
            again: which of them are visited again [B] bool.
            history: where the network led them [N, H, D] [m].
            error: distance of every particle from its true place [N] [spacings].
            static: the windows.
        """
        moved = static.moved
        square = torch.zeros(len(number), dtype=error.dtype, device=error.device)
        square = square.index_add(0, static.batch[moved], error[moved] ** 2)
        count = torch.bincount(static.batch[moved], minlength=len(number)).clamp(min=1)
        good = again & ((square / count).sqrt() <= LARGEST_ERROR)  # false for NaN
        for graph in good.nonzero().flatten().tolist():
            self._histories[int(number[graph])] = history[static.batch == graph].detach().clone()

    def state(self) -> dict[int, Tensor]:
        """Return number → history."""
        return dict(self._histories)

    def load(self, state: Mapping[int, Tensor], numbers: Iterable[int]) -> None:
        """Take up the histories of these numbers from what `state` returned."""
        self._histories = {number: state[number] for number in numbers}
