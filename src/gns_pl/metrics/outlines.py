"""Where a raster is above a level: polygons, by contourpy, which comes with matplotlib (extra `viz`)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from gns_pl.metrics.measures import Floats
from gns_pl.metrics.rasters import MapGrid

EDGE = 1e-6
"""Width of what closes polygons at the edge of the grid, in cells."""


def polygons_above(values: Floats, grid: MapGrid, level: float) -> list[list[Floats]]:
    """Return the polygons in which a raster reaches a level, straight between the middles of cells.

    Up to the edge of the grid the outer cells have one value; beyond it there is nothing, so every polygon is closed.

    Args:
        values: [X, Y], finite.
        grid: the cells.
        level: above zero.

    Returns:
        Of every polygon its rings [P, 2] [m], in the scene's coordinates: the outer one anticlockwise, then the holes
        clockwise, the last point of each the first.
    """
    from contourpy import FillType, contour_generator

    places = []
    for low, number in zip(grid.lower, grid.shape, strict=True):
        inside = np.array([-EDGE, 0.0, *(np.arange(number) + 0.5), number, number + EDGE])
        places.append(low + grid.cell * inside)
    x, y = places
    padded = np.pad(np.pad(values, 1, mode="edge"), 1)
    generator = contour_generator(x, y, padded.T, fill_type=FillType.OuterOffset)
    points, offsets, *_ = generator.filled(level, max(float(values.max()), level) * 2)
    return [
        [np.asarray(rings[start:end], dtype=np.float64) for start, end in pairwise(ends)]
        for rings, ends in zip(points, offsets, strict=True)
        if rings is not None and ends is not None
    ]


def area_of(polygons: list[list[Floats]]) -> float:
    """Return the area of polygons, holes taken off [m²]; Gauss's area formula."""
    total = 0.0
    for ring in (ring for polygon in polygons for ring in polygon):
        x, y = (ring - ring[0]).T
        total += 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])
    return total
