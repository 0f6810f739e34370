"""The ground as a heightfield: heights on a square grid, between them a surface, and what it does to material on it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gns_pl.errors import InputError
from gns_pl.scene.boundaries import Wall
from gns_pl.scene.checks import checked_number
from gns_pl.scene.raster import Raster, cells_extent, checked_array, checked_corner, described

Floats = NDArray[np.float64]

REFINED = 3.0
"""Up to this many cells from the surface its distance is refined at the foot of the perpendicular."""


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground that nothing enters: heights in the middles of a raster's cells, bilinear between them.

    Attributes:
        heights: [NX, NY] [m], x and y rising; [NX] in two dimensions. Half a cell beyond the first and the last the
            surface goes on as steeply as before.
        corner: place of the first height, the middle of the lower left cell [D − 1] [m]. On the map it is at
            `corner` + `Scene.origin`, to be added in float64.
        cell: distance of neighbouring heights [m].
        wall: what the ground does to material at it.
        crs: coordinate reference system of the map as text; "" if unknown.

    Raises:
        InputError: heights that are missing or of another shape, in one sentence.
    """

    heights: Floats
    corner: tuple[float, ...]
    cell: float
    wall: Wall
    crs: str = ""

    def __post_init__(self) -> None:
        heights = checked_array("terrain", "heights", self.heights)
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "corner", checked_corner("terrain", self.corner, heights.ndim))
        object.__setattr__(self, "cell", checked_number("terrain", "cell", self.cell, 0.0, above=True))
        object.__setattr__(self, "crs", str(self.crs))
        if not isinstance(self.wall, Wall):
            raise InputError(f"terrain: wall must be a Wall, not {self.wall!r}.")
        if min(heights.shape) < 2:
            raise InputError(f"terrain: it needs two heights along every axis at least, not {heights.shape}.")
        missing = ~np.isfinite(heights)
        if missing.any():
            first = np.argwhere(missing)[0]
            place = [round(low + self.cell * float(index), 6) for low, index in zip(self.corner, first, strict=True)]
            raise InputError(
                f"terrain: {missing.sum()} of its heights are missing, the first at {place} m; choose a box without "
                "them (lower, upper), or fill them in."
            )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Terrain):
            return NotImplemented
        return self._facts == other._facts and np.array_equal(self.heights, other.heights)

    def __hash__(self) -> int:
        return hash((self._facts, self.heights.tobytes()))

    @property
    def _facts(self) -> tuple[object, ...]:
        return self.heights.shape, self.corner, self.cell, self.wall, self.crs

    @classmethod
    def of(cls, raster: Raster, wall: Wall) -> Terrain:
        """Return the ground of which a raster holds the heights."""
        return cls(raster.values, raster.corner, raster.cell, wall, raster.crs)

    @property
    def raster(self) -> Raster:
        """Its heights as a raster."""
        return Raster(self.heights, self.corner, self.cell, self.crs)

    @property
    def extent(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lower and upper corner of its cells, half a cell around the first and the last height [D − 1] [m]."""
        return cells_extent(self.heights.shape, self.corner, self.cell)

    def replace(self, **changes: object) -> Terrain:
        """Return a copy with some attributes changed, checked again."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def covers(self, lower: Sequence[float], upper: Sequence[float]) -> bool:
        """Tell whether all of a rectangle lies on its cells."""
        near = 1e-6 * self.cell
        first, last = self.extent
        return all(a <= b + near for a, b in zip((*first, *upper), (*lower, *last), strict=True))

    def cropped(self, lower: Sequence[float], upper: Sequence[float]) -> Terrain:
        """Return the least part whose heights surround a rectangle; arguments as `Raster.cropped`."""
        return Terrain.of(self.raster.cropped(lower, upper), self.wall)

    def resampled(self, cell: float) -> Terrain:
        """Return the surface on cells of about another size, each with its mean height; a plane stays that plane.

        Args:
            cell: wanted edge of a cell [m]; the nearest that divides the extent along x is taken.

        Raises:
            InputError: cells so large that fewer than two would be left along an axis.
        """
        lower, upper = self.extent
        length = upper[0] - lower[0]
        size = length / max(1, round(length / cell))
        counts = [int((high - low) / size * (1 + 1e-9)) for low, high in zip(lower, upper, strict=True)]
        if min(counts) < 2:
            raise InputError(f"terrain: cells of {cell:g} m are too large for it, {described(lower, upper)}.")
        edges: list[Floats] = [low + size * np.arange(number + 1.0) for low, number in zip(lower, counts, strict=True)]
        corner = tuple(low + size / 2 for low in lower)
        return Terrain(self.means(edges), corner, size, self.wall, self.crs)

    def means(self, edges: Sequence[Floats]) -> Floats:
        """Return the mean height of the surface over rectangles, exact for the bilinear surface.

        Args:
            edges: of the rectangles along each axis, rising [NX + 1], and [NY + 1] in three dimensions [m].

        Returns:
            [NX, NY], or [NX] [m].
        """
        middle = (self.heights.min() + self.heights.max()) / 2  # sums stay small, and so does their rounding
        means: Floats = self.heights - middle
        for axis, (first, line) in enumerate(zip(self.corner, edges, strict=True)):
            means = np.moveaxis(_line_means(np.moveaxis(means, axis, 0), (line - first) / self.cell), 0, axis)
        return np.ascontiguousarray(means + middle)

    def height(self, places: ArrayLike) -> Floats:
        """Return the height of the surface at places [N, D − 1] [m]; further columns are of no account [N] [m]."""
        return self._surface(np.asarray(places, dtype=np.float64))[0]

    def _surface(self, places: Floats) -> tuple[Floats, Floats]:
        """Return height [N] [m] and slopes [N, D − 1] of the surface."""
        index, part = [], []
        for axis, (first, number) in enumerate(zip(self.corner, self.heights.shape, strict=True)):
            along = (places[:, axis] - first) / self.cell
            start = np.clip(np.floor(along), 0, number - 2)
            index.append(start.astype(np.int64))
            part.append(along - start)
        heights = self.heights
        if len(index) == 1:
            (i,), (s,) = index, part
            rise = heights[i + 1] - heights[i]
            return heights[i] + s * rise, rise[:, None] / self.cell
        (i, j), (s, t) = index, part
        low, high = heights[i, j], heights[i + 1, j]
        low_rise, high_rise = heights[i, j + 1] - low, heights[i + 1, j + 1] - high
        along_x = high - low + t * (high_rise - low_rise)
        along_y = low_rise + s * (high_rise - low_rise)
        height = low + s * (high - low) + t * along_y
        return height, np.stack([along_x, along_y], axis=1) / self.cell

    def signed_distance(self, position: ArrayLike) -> tuple[Floats, Floats]:
        """Return the distance of points from the surface and the direction away from it.

        (z − h) n_z, the distance from the tangent plane below a point; near the surface, that from the tangent plane
        at the foot of this perpendicular, whose error is that of a step of Newton's method. Exact for a plane.

        Args:
            position: [N, D] [m].

        Returns:
            Distance [N] [m], positive above the ground, and unit normal [N, D].
        """
        places = np.array(position, dtype=np.float64)
        across, z = places[:, :-1], places[:, -1]
        distance, normal = _from_tangent(across, z, across, *self._surface(across))
        near = np.abs(distance) < REFINED * self.cell
        foot = across[near] - distance[near, None] * normal[near, :-1]
        distance[near], normal[near] = _from_tangent(across[near], z[near], foot, *self._surface(foot))
        return distance, normal


def check_resolved(
    owner: str,
    heights: Floats,
    *,
    lower: Sequence[float],
    cells: Sequence[float],
    steepest_deg: float,
    roughest: float,
) -> None:
    """Raise an `InputError` where ground is steeper or rougher than the cells of a solver resolve; the place is named.

    Args:
        owner: whose ground, for the message.
        heights: in the middles of cells, or at nodes [NX, NY] or [NX] [m].
        lower: place of the first height [D − 1] [m].
        cells: their edges [D − 1] [m].
        steepest_deg: steepest ground that is run [degrees].
        roughest: largest change of the slope from one cell to the next.
    """
    rises = [np.diff(heights, axis=axis) / cell for axis, cell in enumerate(cells)]
    bends = [np.diff(rise, axis=axis) for axis, rise in enumerate(rises)]
    steepest = max(rises, key=lambda rise: np.abs(rise).max(initial=0.0))
    bent = max(bends, key=lambda bend: np.abs(bend).max(initial=0.0))
    angle = math.degrees(math.atan(np.abs(steepest).max(initial=0.0)))
    bend = float(np.abs(bent).max(initial=0.0))
    if angle <= steepest_deg and bend <= roughest:
        return
    if angle > steepest_deg:
        worst, what, cure = (
            steepest,
            f"as steep as {angle:.0f}°, and {steepest_deg:g}° is the most that is run",
            "larger",
        )
    else:
        worst, what, cure = bent, f"so rough that its slope changes by {bend:.2g} from one to the next", "smaller"
    index = np.unravel_index(int(np.abs(worst).argmax()), worst.shape)
    place = ", ".join(f"{low + cell * (int(i) + 0.5):.6g}" for low, cell, i in zip(lower, cells, index, strict=True))
    raise InputError(
        f"{owner}: on cells of {max(cells):.3g} m the ground at ({place}) m is {what}; smooth it (terrain.resample), "
        f"choose another part of it, or {cure} cells."
    )


def _from_tangent(across: Floats, z: Floats, foot: Floats, height: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Return distance [N] and normal [N, D] of points from the tangent planes at other places."""
    normal = np.concatenate([-slope, np.ones((len(slope), 1))], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return (z - height) * normal[:, -1] + ((across - foot) * normal[:, :-1]).sum(axis=1), normal


def _line_means(values: Floats, edges: Floats) -> Floats:
    """Return the means of piecewise linear functions [N, …] between edges, in steps from the first value [M + 1]."""
    start = np.clip(np.floor(edges), 0, len(values) - 2).astype(np.int64)
    part = (edges - start).reshape(-1, *(1,) * (values.ndim - 1))
    whole = np.concatenate([np.zeros_like(values[:1]), np.cumsum((values[1:] + values[:-1]) / 2, axis=0)])
    rise = values[start + 1] - values[start]
    integral = whole[start] + part * values[start] + part**2 / 2 * rise
    return np.asarray(np.diff(integral, axis=0) / np.diff(edges).reshape(-1, *(1,) * (values.ndim - 1)))
