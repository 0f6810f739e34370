"""Errors that neighbours have in common: means over columns, and what grows with height in them.

What a flow does as a whole is what its particles have in common. Of accelerations that is a small part, and drowns in
what each has alone: a network may explain half of these and still slow a whole layer down by a third of its friction,
or let it sink into a sheet.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from gns_pl.graph.context import nodes_around
from gns_pl.graph.features import SceneBatch

SPAN = 3.0
"""Edge of the cells that columns are averaged over, in connectivity radii: a layer one particle thick has 25 there."""


class ColumnMeans:
    """Means over columns, and what grows with height in them, of what moved particles have; with multilinear weights.

    Args:
        position: [N, D] [m].
        scenes: of the particles.
        radius: connectivity radius [m].
    """

    def __init__(self, position: Tensor, scenes: SceneBatch, radius: float) -> None:
        grid, moved, height = scenes.grid(SPAN * radius, axes=position.shape[1] - 1), scenes.moved, position[:, -1]
        if scenes.surfaces is not None:
            height = height - scenes.surfaces.fields(position, scenes.batch, radius).ground
        self.node, self.weight, _ = nodes_around(position[moved, :-1], grid, scenes.batch[moved])
        self.nodes = scenes.num_graphs * math.prod(grid.shape)
        self.number = self._sums(torch.ones_like(height[moved])[:, None])
        mean = self._sums(height[moved, None]) / self.number.clamp_min(1e-6)
        self.over = height[moved, None] - mean.index_select(0, self.node).view(self.weight.shape)
        self.spread = self._sums(self.over.square())

    def square(self, error: Tensor) -> Tensor:
        """Return the sum of squares of the two parts of errors, each as often as its column has particles [].

        Args:
            error: of the moved particles [M, D].
        """
        mean = self._sums(error).square().sum(dim=1, keepdim=True) / self.number.clamp_min(1e-6)
        tilt = self._sums(self.over * error).square().sum(dim=1, keepdim=True) / self.spread.clamp_min(1e-12)
        return mean.sum() + tilt.sum()

    def _sums(self, value: Tensor) -> Tensor:
        """Return weighted sums of columns [G, K], of values of particles [M, K] or of these at nodes [2^A, M, K]."""
        parts = (self.weight * value).flatten(0, 1)
        return parts.new_zeros(self.nodes, parts.shape[1]).index_add(0, self.node, parts)
