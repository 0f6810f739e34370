"""Augmentation by the symmetries of a box under gravity: mirrors of the horizontal axes and their exchange."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gns_pl.graph import SceneBatch, WindowRandom


@dataclasses.dataclass(frozen=True)
class Symmetry:
    """What is done to every scene of a batch: axes are mirrored, then exchanged.

    Attributes:
        sign: −1 where an axis is mirrored, else 1 [B, D].
        offset: what a mirrored coordinate is counted from, 0 for others [B, D] [m].
        order: of the axes afterwards [B, D].
    """

    sign: Tensor
    offset: Tensor
    order: Tensor

    @classmethod
    def sample(cls, scenes: SceneBatch, random: WindowRandom, dtype: torch.dtype) -> Symmetry:
        """Mirror every scene at the middle planes of its box at random, and exchange x and y at random (D = 3).

        Args:
            scenes: their boxes.
            random: the windows' random numbers.
            dtype: of the positions.
        """
        graphs, dim = scenes.lower.shape
        flipped = random.uniform("symmetry", 3, dtype=dtype) < 0.5
        mirrored = torch.zeros((graphs, dim), dtype=torch.bool, device=scenes.lower.device)
        mirrored[:, : dim - 1] = flipped[:, : dim - 1]
        order = torch.arange(dim, device=scenes.lower.device).repeat(graphs, 1)
        if dim == 3:
            exchanged = flipped[:, 2]
            order[exchanged, 0], order[exchanged, 1] = 1, 0
        return cls(torch.where(mirrored, -1.0, 1.0), torch.where(mirrored, scenes.lower + scenes.upper, 0.0), order)

    def turned(self, position: Tensor, batch: Tensor, *, vectors: bool = False) -> Tensor:
        """Return positions of several frames after it [N, T, D] [m].

        Args:
            position: [N, T, D] [m].
            batch: scene of every particle [N].
            vectors: they are vectors, such as velocities, and no places.
        """
        turned = self.sign[batch][:, None] * position
        if not vectors:
            turned = turned + self.offset[batch][:, None]
        return turned.gather(-1, self.order[batch][:, None].expand_as(position))

    def undone(self, position: Tensor, batch: Tensor, *, vectors: bool = False) -> Tensor:
        """Return positions of several frames before it [N, T, D] [m]; arguments as those of `turned`."""
        back = position.gather(-1, self.order[batch][:, None].expand_as(position))
        return self.sign[batch][:, None] * (back if vectors else back - self.offset[batch][:, None])

    def scenes(self, scenes: SceneBatch) -> SceneBatch:
        """Return the scenes after it, box and gravity."""
        return dataclasses.replace(
            scenes,
            lower=scenes.lower.gather(1, self.order),
            upper=scenes.upper.gather(1, self.order),
            gravity=(self.sign * scenes.gravity).gather(1, self.order),
            surfaces=scenes.surfaces and scenes.surfaces.turned(self.sign, self.offset, self.order),
        )


def sample_symmetry(position: Tensor, scenes: SceneBatch, random: WindowRandom) -> tuple[Tensor, SceneBatch]:
    """Return positions and scenes after a random symmetry of each scene; opposite walls are taken to be alike.

    Args:
        position: of several frames [N, T, D] [m].
        scenes: those that are stepped.
        random: the windows' random numbers.
    """
    symmetry = Symmetry.sample(scenes, random, position.dtype)
    return symmetry.turned(position, scenes.batch), symmetry.scenes(scenes)
