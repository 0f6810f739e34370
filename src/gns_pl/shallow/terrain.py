"""A scene's terrain in the cells of a layer: mean heights, how it is curved, and particles on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gns_pl.scene import Scene
from gns_pl.scene.terrain import check_resolved

if TYPE_CHECKING:
    from gns_pl.shallow.plan import Grid

CLIFF = 2.0
"""A bed that rises by more than this many cells from one cell to the next is a wall to a layer that is lower."""

Floats = NDArray[np.float64]

STEEPEST_DEG = 60.0
"""Steepest ground that is run [degrees]."""

ROUGHEST = 2.0
"""Largest change of the ground's slope from one cell to the next that is run."""


def terrain_height(scene: Scene, grid: Grid) -> Floats:
    """Return the mean height of the terrain in every cell [NX, NY] [m].

    Raises:
        InputError: ground that is steeper or rougher than the cells resolve.
    """
    assert scene.terrain is not None
    edges = grid.edges[: scene.dim - 1]
    heights = scene.terrain.means(edges)
    check_resolved(
        f"shallow: scene {scene.name!r}",
        heights,
        lower=[float(line[:2].mean()) for line in edges],
        cells=grid.sizes[: scene.dim - 1],
        steepest_deg=STEEPEST_DEG,
        roughest=ROUGHEST,
    )
    return heights.reshape(grid.shape)


def terrain_curve(height: Floats, grid: Grid, earth_pressure: float) -> Floats:
    """Return slopes and second derivatives of heights in cells, central differences, as `Ground.curve` [C, 6].

    The bed of a cell is linear, so on curved ground it misses that of the next cell at the face between them. The last
    column is half the second difference (of the bed that the equations have, over k), of both axes together, by which
    it does so at most.

    Args:
        height: mean heights [NX, NY] [m].
        grid: the cells.
        earth_pressure: k.
    """
    dx, dy = grid.sizes
    flat = np.zeros_like(height)

    def slope(values: Floats, axis: int) -> Floats:
        return np.asarray(np.gradient(values, (dx, dy)[axis], axis=axis)) if height.shape[axis] > 1 else flat

    def bend(axis: int) -> Floats:
        inner = tuple((1, 1) if axis == each else (0, 0) for each in (0, 1))
        return np.pad(np.abs(np.diff(height, 2, axis=axis)), inner) if height.shape[axis] > 2 else flat

    along, across = slope(height, 0), slope(height, 1)
    xx, yy, twist = slope(along, 0), slope(across, 1), (slope(along, 1) + slope(across, 0)) / 2
    tooth = (bend(0) + bend(1)) / (2 * earth_pressure)
    return np.stack([along, across, xx, twist, yy, tooth], axis=-1).reshape(-1, 6)


def mean_heights(scene: Scene, grid: Grid) -> Floats:
    """Return the terrain's mean height in every cell [C] [m]; none without a terrain [0]."""
    return np.zeros(0) if scene.terrain is None else scene.terrain.means(grid.edges[: scene.dim - 1]).ravel()


def lift_onto_terrain(scene: Scene, grid: Grid, height: Floats, means: Floats, position: Floats) -> None:
    """Move particles from the steps that cells are to the surface of the terrain, where it is the bed; in place.

    Args:
        scene: with a terrain, or nothing is done.
        grid: the cells.
        height: of the bed in them [C] [m].
        means: of the terrain in them (`mean_heights`) [C] [m].
        position: x, y and z of the particles [N, 3] [m].
    """
    if scene.terrain is None:
        return
    places = [
        np.clip(np.searchsorted(edges, place, side="right") - 1, 0, len(edges) - 2)
        for edges, place in zip(grid.edges, position[:, :2].T, strict=True)
    ]
    cell = places[0] * grid.shape[1] + places[1]
    mean = means[cell]
    above = scene.terrain.height(position[:, : scene.dim - 1]) - mean
    position[:, 2] += np.where(mean >= height[cell], above, 0.0)
