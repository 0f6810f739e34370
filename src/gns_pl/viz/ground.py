"""The ground of a scene as a surface over the horizontal plane, for maps and for ParaView."""

from __future__ import annotations

import math

import numpy as np

from gns_pl.metrics.measures import Floats
from gns_pl.metrics.rasters import MapGrid
from gns_pl.scene import Plane, Scene
from gns_pl.shallow.plan import STEEPEST, plane_height


def ground_height(scene: Scene, grid: MapGrid) -> Floats:
    """Return the height of floor, terrain, slopes and boxes in the middle of every cell [X, Y] [m].

    Planes that are walls, steeper than 60°, are no ground.
    """
    height = np.full(math.prod(grid.shape), scene.lower[-1])
    x, y = (places.ravel() for places in np.meshgrid(*grid.centres, indexing="ij"))
    if scene.terrain is not None:
        height = np.maximum(height, scene.terrain.height(np.stack([x, y], axis=1)))
    for obstacle in scene.obstacles:
        if not isinstance(obstacle, Plane):
            inside = np.ones(len(x), dtype=bool)
            for axis, place in enumerate((x, y)):
                inside &= (place >= obstacle.position[axis]) & (place <= obstacle.upper[axis])
            height[inside] = np.maximum(height[inside], obstacle.upper[-1])
        elif obstacle.normal[-1] >= STEEPEST:
            height = np.maximum(height, plane_height(obstacle, x, y))
    return height.reshape(grid.shape)
