"""Augmentation by the symmetries of a box under gravity: mirrors of the horizontal axes and their exchange."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gns_pl.graph import SceneBatch, WindowRandom


def sample_symmetry(position: Tensor, scenes: SceneBatch, random: WindowRandom) -> tuple[Tensor, SceneBatch]:
    """Mirror every scene at the middle planes of its box at random, and exchange x and y at random (D = 3).

    Gravity is mirrored and exchanged along, and so is the box; opposite walls are taken to be alike.

    Args:
        position: of several frames [N, T, D] [m].
        scenes: those that are stepped.
        random: the windows' random numbers.

    Returns:
        Positions and scenes after the same random symmetry, one per scene.
    """
    graphs, dim = scenes.lower.shape
    flipped = random.uniform("symmetry", 3, dtype=position.dtype) < 0.5
    mirrored = torch.zeros((graphs, dim), dtype=torch.bool, device=position.device)
    mirrored[:, : dim - 1] = flipped[:, : dim - 1]
    both_corners = scenes.lower + scenes.upper
    sign = torch.where(mirrored, -1.0, 1.0)
    offset = torch.where(mirrored, both_corners, 0.0)
    order = torch.arange(dim, device=position.device).repeat(graphs, 1)
    if dim == 3:
        exchanged = flipped[:, 2]
        order[exchanged, 0], order[exchanged, 1] = 1, 0

    reflected = sign[scenes.batch][:, None] * position + offset[scenes.batch][:, None]
    turned = reflected.gather(-1, order[scenes.batch][:, None].expand_as(position))
    turned_scenes = dataclasses.replace(
        scenes,
        lower=scenes.lower.gather(1, order),
        upper=scenes.upper.gather(1, order),
        gravity=(sign * scenes.gravity).gather(1, order),
    )
    return turned, turned_scenes
