"""The rigid surfaces of a scene as tensors: what `graph.surfaces` is made of."""

from __future__ import annotations

import math

import numpy as np
import torch

from gns_pl.graph.surfaces import Surfaces
from gns_pl.scene import Box, Plane, Scene, Wall


def surfaces_of(scene: Scene, cell: float) -> Surfaces:
    """Return the faces of the box, the obstacles and the ground of a scene.

    The ground is the terrain, or the lower face of the box where that is higher or there is no terrain; its heights are
    means over cells, as a simulator sees nothing finer than its particles.

    Args:
        scene: with its walls, obstacles and terrain.
        cell: wanted edge of the ground's cells [m].
    """
    axes = np.eye(scene.dim)
    planes: list[tuple[float, ...]] = []
    grips: list[float] = []
    names = "xz" if scene.dim == 2 else "xyz"
    for axis, name in enumerate(names):
        for sign, side, corner in ((1.0, "-", scene.lower), (-1.0, "+", scene.upper)):
            if (name, side) != ("z", "-"):
                planes.append((*(sign * axes[axis]), sign * corner[axis]))
                grips.append(grip(scene.walls[f"{name}{side}"]))
    inclined = [obstacle for obstacle in scene.obstacles if isinstance(obstacle, Plane)]
    blocks = [obstacle for obstacle in scene.obstacles if isinstance(obstacle, Box)]
    planes += [(*each.normal, float(np.dot(each.normal, each.point))) for each in inclined]
    grips += [grip(each.wall) for each in inclined]
    heights, first, size = _ground(scene, cell)
    wall = scene.walls["z-"] if scene.terrain is None else scene.terrain.wall
    rows = torch.tensor(planes, dtype=torch.float32)

    def corners(name: str) -> torch.Tensor:
        values = [each.position if name == "lower" else each.upper for each in blocks]
        return torch.tensor(values, dtype=torch.float32).reshape(1, len(blocks), scene.dim)

    return Surfaces(
        normal=rows[None, :, :-1].contiguous(),
        offset=rows[None, :, -1].contiguous(),
        plane_grip=torch.tensor([grips]),
        lower=corners("lower"),
        upper=corners("upper"),
        cuboid_grip=torch.tensor([[grip(each.wall) for each in blocks]]).reshape(1, len(blocks)),
        heights=torch.from_numpy(heights.ravel().astype(np.float32)),
        first=torch.zeros(1, dtype=torch.int64),
        shape=torch.tensor([heights.shape]),
        corner=torch.tensor([first], dtype=torch.float32),
        cell=torch.tensor([size], dtype=torch.float32),
        ground_grip=torch.tensor([grip(wall)]),
        inner=bool(scene.obstacles) or scene.terrain is not None,
    )


def grip(wall: Wall) -> float:
    """Return how a surface holds what slides along it: 0 where all slips, μ / (1 + μ), 1 where all sticks."""
    return 1.0 if wall.condition == "stick" else wall.friction / (1 + wall.friction)


def _ground(scene: Scene, cell: float) -> tuple[np.ndarray, list[float], float]:
    """Return heights [X, Y] or [X] [m], place of the first [m] and their distance [m]; the box's edges lie within."""
    lower, upper = np.array(scene.lower[:-1]), np.array(scene.upper[:-1])
    if scene.terrain is None:
        size = float((upper - lower).max())
        return np.full((3,) * len(lower), scene.lower[-1]), list(lower - size / 2), size
    numbers = [math.ceil((high - low) / cell - 1e-9) + 2 for low, high in zip(lower, upper, strict=True)]
    edges = [low + cell * (np.arange(number + 1) - 1.0) for low, number in zip(lower, numbers, strict=True)]
    heights = np.maximum(scene.terrain.means(edges), scene.lower[-1])
    return heights, list(lower - cell / 2), cell
