"""What a network saw in training, in few numbers: where its inputs lay, and how far off others are.

A distance says how unlike its inputs are to those it learned from. It knows nothing of what no input shows, as the
friction of a wall; `solvers.training_range` looks at the scene instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

QUANTILE = 0.001
"""Of the inputs seen, so many lie below the range of a feature, and as many above."""

LEAST_SPREAD = 0.05
"""Features are of the order of one; one that hardly varied in training, as the sand's friction, counts as if it had
varied by so much. It is also how far beyond its range such a feature may lie."""

RIDGE = 0.05
"""Added to the correlations: what was always tied together in training may come apart a bit."""

USUAL = 0.99
"""Distances are over the one that so many of the inputs seen stay below."""


def surroundings(position: Tensor, velocity: Tensor, edge_index: Tensor, radius: float) -> Tensor:
    """Return number of neighbours, distance of the nearest over R (1 without any), speed against their mean [N, 3].

    Args:
        position: [N, D] [m].
        velocity: over any scale [N, D]; the speed is over the same.
        edge_index: [2, E], sender and receiver; what joins a particle to itself does not count.
        radius: connectivity radius R [m].
    """
    sender, receiver = edge_index[:, edge_index[0] != edge_index[1]]
    number = position.new_zeros(len(position)).index_add(0, receiver, position.new_ones(len(receiver)))
    distance = (position[sender] - position[receiver]).norm(dim=1) / radius
    nearest = position.new_ones(len(position)).scatter_reduce(0, receiver, distance, "amin")
    mean = torch.zeros_like(velocity).index_add(0, receiver, velocity[sender]) / number.clamp(min=1)[:, None]
    passing = torch.where(number > 0, (velocity - mean).norm(dim=1), 0.0)
    return torch.stack([number / 10, nearest, passing], dim=1)


@dataclass(frozen=True)
class TrainingDistribution:
    """A summary of the inputs of many particles in training.

    Attributes:
        names: of the F features.
        low: `QUANTILE` of each [F].
        high: the same from above [F].
        mean: [F].
        spread: standard deviations, at least `LEAST_SPREAD` [F].
        whitening: [F, F]; (f − mean) / spread times its transpose is uncorrelated and of variance one.
        usual: root mean square over the features of what is so whitened, which `USUAL` of the inputs stay below.
        source: hash of the manifest of the data.
    """

    names: tuple[str, ...]
    low: Tensor
    high: Tensor
    mean: Tensor
    spread: Tensor
    whitening: Tensor
    usual: float
    source: str = ""

    @classmethod
    def of(cls, features: Tensor, names: Sequence[str], source: str = "") -> TrainingDistribution:
        """Summarise inputs.

        Args:
            features: [M, F].
            names: of the F features.
            source: hash of the manifest of the data.
        """
        values = features.double()
        low, high = torch.quantile(values, values.new_tensor([QUANTILE, 1 - QUANTILE]), dim=0)
        mean, spread = values.mean(dim=0), values.std(dim=0, correction=0).clamp(min=LEAST_SPREAD)
        scaled = (values - mean) / spread
        covariance = scaled.T @ scaled / len(scaled) + RIDGE * torch.eye(len(mean), dtype=scaled.dtype)
        inverse = torch.linalg.inv(torch.linalg.cholesky(covariance))
        usual = torch.quantile((scaled @ inverse.T).square().mean(dim=1).sqrt(), USUAL)
        low, high, mean, spread, inverse = (value.float() for value in (low, high, mean, spread, inverse))
        return cls(tuple(names), low, high, mean, spread, inverse, float(usual), source)

    def distance(self, features: Tensor) -> Tensor:
        """Return how far off each input is, 1 where one in a hundred of training is farther (Mahalanobis) [N].

        Args:
            features: [N, F].
        """
        scaled = (features - self.mean.to(features)) / self.spread.to(features)
        return (scaled @ self.whitening.to(features).T).square().mean(dim=1).sqrt() / self.usual

    def outside(self, features: Tensor) -> Tensor:
        """Return which features lie outside their range [N, F] bool.

        Args:
            features: [N, F].
        """
        slack = LEAST_SPREAD * self.spread.to(features)
        return (features < self.low.to(features) - slack) | (features > self.high.to(features) + slack)

    def to_dict(self) -> dict[str, Any]:
        """Return it as tensors and plain values."""
        return {**vars(self), "names": list(self.names)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrainingDistribution:
        """Return what `to_dict` gave."""
        return cls(**{**data, "names": tuple(data["names"])})
