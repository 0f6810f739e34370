"""Where the material lies, seen from above: volume on a horizontal grid, and how much of it is in the wrong place.

Particles of any number and size are compared, each by its own volume. A run in two dimensions has a profile along x.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gns_pl.metrics.measures import Floats
from gns_pl.scene import Scene
from gns_pl.scene.extent import initial_extent

MAP_CELL = 1 / 12
"""Wanted distance of the grid's nodes [m]: two particle spacings of MPM on the paper's cells."""

TERRAIN_NODES = 4.0
"""Nodes over √(L0 H0) on a terrain, where scenes are of all sizes; of the paper's columns about as many."""


def map_cell(scene: Scene) -> float:
    """Return the wanted distance of nodes of a scene's map where nobody says [m]."""
    return MAP_CELL if scene.terrain is None else math.sqrt(math.prod(initial_extent(scene))) / TERRAIN_NODES


def map_cells(scene: Scene, cell: float) -> NDArray[np.int64]:
    """Return how many cells the map of a scene has along each horizontal axis [D - 1]; arguments as of `volume_map`."""
    extent = np.array(scene.upper[:-1]) - np.array(scene.lower[:-1])
    return np.asarray(np.maximum(1, np.rint(extent / cell)), dtype=np.int64)


def volume_map(position: Floats, volume: Floats, scene: Scene, cell: float | None = None) -> Floats:
    """Return the volume at every node of a horizontal grid over the box; its sum is that of the particles.

    Each particle gives its volume to the nodes around it by linear weights, so the map changes steadily as particles
    move. What has left the box counts at its wall.

    Args:
        position: [N, D] [m].
        volume: of each particle [N] [m^D].
        scene: for the box.
        cell: wanted distance of nodes [m]; each axis takes the nearest that divides the box. None: `map_cell`.

    Returns:
        [X + 1, Y + 1], or [X + 1] in two dimensions [m^D].
    """
    lower, upper = (np.array(corner[:-1]) for corner in (scene.lower, scene.upper))
    number = map_cells(scene, map_cell(scene) if cell is None else cell)
    place = np.clip((position[:, :-1] - lower) / (upper - lower), 0.0, 1.0) * number
    node = np.minimum(place.astype(np.int64), number - 1)
    share = place - node
    total = np.zeros(np.prod(number + 1))
    for corner in product((0, 1), repeat=scene.dim - 1):
        weight = np.prod(np.where(corner, share, 1 - share), axis=1)
        index = np.ravel_multi_index((node + np.array(corner)).T, tuple(number + 1))
        total += np.bincount(index, weights=weight * volume, minlength=len(total))
    return total.reshape(number + 1)


def thickness_map(position: Floats, volume: Floats, scene: Scene, cell: float | None = None) -> Floats:
    """Return volume per area at every node [m]: the height of the deposit, were it filled evenly from the floor.

    Args:
        position: as of `volume_map`, like the others.
        volume: likewise.
        scene: likewise.
        cell: likewise.

    Returns:
        In the shape of `volume_map` [m]. A node at a wall has half the area of others, one in a corner a quarter.
    """
    volumes = volume_map(position, volume, scene, cell)
    for axis, nodes in enumerate(volumes.shape):
        width = np.full(nodes, (scene.upper[axis] - scene.lower[axis]) / (nodes - 1))
        width[[0, -1]] /= 2
        volumes = volumes / np.expand_dims(width, tuple(other for other in range(volumes.ndim) if other != axis))
    return volumes


def map_error(volumes: Floats, reference: Floats) -> float:
    """Return the share of the volume that lies in the wrong place, Σ |V − V_ref| / (2 Σ V_ref).

    0.05 means that 5 % would have to be carried elsewhere. Two maps without a common node are at 1.

    Args:
        volumes: `volume_map` of what is judged.
        reference: of what it should be, in the same shape.
    """
    return float(np.abs(volumes - reference).sum() / (2 * reference.sum()))
