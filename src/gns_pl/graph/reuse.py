"""Neighbours that are searched again only when particles have moved (Verlet 1967)."""

from __future__ import annotations

import torch
from torch import Tensor

from gns_pl.graph.cells import filter_pairs
from gns_pl.graph.neighbours import radius_graph

_ROUNDING = 1.0 - 1e-4


class NeighbourList:
    """`radius_graph`, with the same result, that keeps the pairs closer than the radius and a skin.

    While no particle has moved further than half the skin since these were found, the edges are among them. Where
    particles move so fast that the pairs would not last three steps, there is no list: each step searches anew.

    Args:
        skin: in connectivity radii.
    """

    def __init__(self, skin: float) -> None:
        self.skin = skin
        self._pairs: Tensor | None = None
        self._found_at = self._before = torch.empty(0)
        self._batch: Tensor | None = None

    def __call__(
        self,
        position: Tensor,
        radius: float,
        batch: Tensor | None = None,
        *,
        backend: str = "auto",
        num_graphs: int = 1,
    ) -> Tensor:
        """Return the edges [2, E]; arguments, order and errors are those of `radius_graph`."""
        now, allowed = position.detach(), _ROUNDING * 0.5 * self.skin * radius
        if self._batch is not batch or self._before.shape != now.shape:
            self._pairs, self._before, self._batch = None, now, batch
        last_step, self._before = _longest(now, self._before), now
        if self._pairs is None or not _longest(now, self._found_at) < allowed:
            self._pairs = None
            if not 3 * last_step < allowed:
                return radius_graph(position, radius, batch, backend=backend, num_graphs=num_graphs)
            reach = (1 + self.skin) * radius
            self._pairs = radius_graph(position, reach, batch, backend=backend, num_graphs=num_graphs)
            self._found_at = now
        if now.device.type == "cpu":
            values = now.contiguous().numpy()
            return torch.from_numpy(filter_pairs(values, self._pairs.numpy(), values.dtype.type(radius**2)))
        sender, receiver = self._pairs
        close = (now[receiver] - now[sender]).square().sum(dim=1) < radius**2
        return self._pairs[:, close]


def _longest(now: Tensor, before: Tensor) -> float:
    """Return the largest displacement [m]; NaN where one is not finite."""
    return float((now - before).square().sum(dim=1).max()) ** 0.5 if len(now) else 0.0
