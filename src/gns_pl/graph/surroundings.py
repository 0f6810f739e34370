"""What a particle's features leave out and its edges hold: how many neighbours, how near, how fast they pass."""

from __future__ import annotations

import torch
from torch import Tensor


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
    return torch.stack([number, nearest, passing], dim=1)
