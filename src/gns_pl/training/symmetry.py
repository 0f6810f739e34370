"""Augmentation by the symmetries of a box under gravity: mirrors of the horizontal axes and their exchange."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gns_pl.graph import Draws, Static


def sample_symmetry(
    history: Tensor, next_position: Tensor, static: Static, draws: Draws
) -> tuple[Tensor, Tensor, Static]:
    """Mirror every scene at the middle planes of its box at random, and exchange x and y at random (D = 3).

    Gravity is mirrored and exchanged along, and so is the box; opposite walls are taken to be alike.

    Args:
        history: [N, H, D] [m].
        next_position: [N, D] [m].
        static: the scenes.
        draws: the windows' random numbers.

    Returns:
        History, next position and scenes after the same random symmetry, one per scene.
    """
    graphs, dim = static.lower.shape
    draw = draws.uniform("symmetry", 3, dtype=history.dtype) < 0.5
    mirrored = torch.zeros((graphs, dim), dtype=torch.bool, device=history.device)
    mirrored[:, : dim - 1] = draw[:, : dim - 1]
    both_corners = static.lower + static.upper
    sign = torch.where(mirrored, -1.0, 1.0)
    offset = torch.where(mirrored, both_corners, 0.0)
    order = torch.arange(dim, device=history.device).repeat(graphs, 1)
    if dim == 3:
        exchanged = draw[:, 2]
        order[exchanged, 0], order[exchanged, 1] = 1, 0

    def moved(values: Tensor) -> Tensor:
        per_particle = (len(values), *(1,) * (values.ndim - 2), dim)
        reflected = sign[static.batch].view(per_particle) * values + offset[static.batch].view(per_particle)
        return reflected.gather(-1, order[static.batch].view(per_particle).expand_as(values))

    scenes = dataclasses.replace(
        static,
        lower=static.lower.gather(1, order),
        upper=static.upper.gather(1, order),
        gravity=(sign * static.gravity).gather(1, order),
    )
    return moved(history), moved(next_position), scenes
