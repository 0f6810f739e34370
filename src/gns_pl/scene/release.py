"""A release: what starts as a layer on the ground, of a polygon and a thickness, or of a raster of thicknesses."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.definition import Body
from gns_pl.scene.raster import Raster, described
from gns_pl.scene.terrain import Terrain

Floats = NDArray[np.float64]
Rings: TypeAlias = tuple[tuple[tuple[float, float], ...], ...]

MIN_SHARE = 0.8
"""Particles that would stand for less than this share of a release's volume, or for more than one over it, do not
resolve its outline."""


@dataclass(frozen=True)
class Release(Body):
    """Material between the ground and a surface above it; `position` and `size` are those of a cuboid around it.

    Attributes:
        thickness: vertical, from the ground up [m]: one inside `outline`, or a raster, 0 where there is nothing.
        outline: rings of corners (x, y) [m], each closed by its first corner; what lies in an even number of rings is
            outside. Empty with a raster.
    """

    needs_terrain: ClassVar[bool] = True
    thickness: float | Raster = 0.0
    outline: Rings = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.thickness, Raster):
            values = np.nan_to_num(self.thickness.values)
            if values.ndim != 2 or values.min() < 0 or not values.max() > 0:
                raise InputError("release: a raster of thicknesses must be of two axes, nowhere negative and not zero.")
            if self.outline:
                raise InputError("release: give an outline and one thickness, or a raster of thicknesses alone.")
            object.__setattr__(self, "outline", ())
        else:
            thickness = checked_number("release", "thickness", self.thickness, 0.0, above=True)
            object.__setattr__(self, "thickness", thickness)
            object.__setattr__(self, "outline", checked_rings(self.outline))
            if not self.outline:
                raise InputError("release: one thickness needs an outline, and there is none.")

    @property
    def height(self) -> float:
        """Largest thickness [m]."""
        return float(np.nanmax(self.thickness.values)) if isinstance(self.thickness, Raster) else self.thickness

    @property
    def volume(self) -> float:
        """Of all of it [m³]."""
        if isinstance(self.thickness, Raster):
            return float(np.nansum(self.thickness.values)) * self.thickness.cell**2
        rings = [np.array(ring) for ring in self.outline]
        area = 0.0
        for number, ring in enumerate(rings):
            inside = [other for index, other in enumerate(rings) if index != number]
            sign = 1 - 2 * int(is_inside(ring.mean(axis=0)[None] * 1e-9 + ring[:1] * (1 - 1e-9), inside)[0])
            x, y = (ring - ring[0]).T
            area += sign * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
        return area * self.thickness

    def depth(self, places: Floats) -> Floats:
        """Return the thickness at places [N, 2] [m], 0 outside [N] [m]."""
        if not isinstance(self.thickness, Raster):
            return np.where(is_inside(places, [np.array(ring) for ring in self.outline]), self.thickness, 0.0)
        raster = self.thickness
        index = np.floor((places - raster.corner) / raster.cell + 0.5).astype(np.int64)
        known = ((index >= 0) & (index < raster.values.shape)).all(axis=1)
        depth = np.zeros(len(places))
        depth[known] = np.nan_to_num(raster.values[tuple(index[known].T)])
        return depth

    def means(self, edges: Sequence[Floats]) -> Floats:
        """Return the mean thickness over rectangles, of 8 × 8 places in each; the volume is the release's.

        Args:
            edges: of the rectangles along x [NX + 1] and y [NY + 1], around the release [m].

        Returns:
            [NX, NY] [m].
        """
        shares = (np.arange(8) + 0.5) / 8
        lines = [(line[:-1, None] + np.diff(line)[:, None] * shares).ravel() for line in edges]
        places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
        x, y = (len(line) - 1 for line in edges)
        means = self.depth(places).reshape(x, 8, y, 8).mean(axis=(1, 3))
        total = float((means * np.outer(*map(np.diff, edges))).sum())
        return np.asarray(means * (self.volume / total if total > 0 else 0.0))

    def moved(self, move: Callable[[Sequence[float]], tuple[float, ...]]) -> Release:
        """Return it with all its places moved.

        Args:
            move: a place (x, y, z) [m] → the new one.
        """
        from dataclasses import replace

        def across(place: Sequence[float]) -> tuple[float, float]:
            x, y, _ = move((*place, 0.0))
            return x, y

        thickness = self.thickness
        if isinstance(thickness, Raster):
            thickness = replace(thickness, corner=across(thickness.corner))
        outline = tuple(tuple(across(corner) for corner in ring) for ring in self.outline)
        return replace(self, position=move(self.position), thickness=thickness, outline=outline)

    def overlaps(self, other: Body) -> bool:
        """Tell whether it has ground in common with another body, at 64 × 64 places of the cuboids' common part."""
        low, high = np.maximum(self.position, other.position)[:2], np.minimum(self.upper, other.upper)[:2]
        if not super().overlaps(other) or (low >= high).any():
            return False
        places = (low + (high - low) * (np.indices((64, 64)).reshape(2, -1).T + 0.5) / 64).astype(np.float64)
        common = self.depth(places) > 0
        if isinstance(other, Release):
            common &= other.depth(places) > 0
        return bool(common.any())

    def columns(
        self, spacing: float, ground: Callable[[Floats], Floats], offset: Callable[[int], Floats | float]
    ) -> Filling:
        """Return particles in columns from the ground up, whose volumes add up to the release's.

        Args:
            spacing: wanted distance of neighbouring particles [m].
            ground: places [N, 2] [m] → height of the ground there [N] [m].
            offset: number of particles N → offset of each from the middle of its cell [N, 3], in cells.

        Returns:
            Position [N, 3] [m], volume [N] [m³] and place in the lattice [N, 3].

        Raises:
            InputError: an outline that the spacing does not resolve.
        """
        count = [max(1, round(edge / spacing)) for edge in self.size[:2]]
        cell = np.array(self.size[:2]) / count
        column = np.indices(count).reshape(2, -1).T
        depth = self.depth(np.array(self.position[:2]) + (column + 0.5) * cell)
        share = float(depth.sum() * cell.prod()) / self.volume
        if not MIN_SHARE < share < 1 / MIN_SHARE:
            raise InputError(
                f"a release of {self.volume:.4g} m³ would be filled with {share:.0%} of that by particles "
                f"{spacing:g} m apart; choose smaller cells."
            )
        number = np.where(depth > 0, np.maximum(1, np.rint(depth / spacing)), 0).astype(np.int64)
        first = np.repeat(np.cumsum(number) - number, number)
        layer = np.arange(number.sum()) - first
        lattice = np.column_stack([np.repeat(column, number, axis=0), layer])
        middle = lattice + 0.5 + offset(len(lattice))
        thick, layers = np.repeat(depth, number), np.repeat(number, number)
        across = np.array(self.position[:2]) + middle[:, :2] * cell
        position = np.column_stack([across, ground(across) + middle[:, 2] * thick / layers])
        return position, thick / layers * cell.prod() / share, lattice


Filling: TypeAlias = tuple[Floats, Floats, NDArray[np.int64]]


def make_release(
    terrain: Terrain,
    *,
    thickness: float | Raster,
    outline: Any = (),
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    material: str = "sand",
) -> Release:
    """Return a release on a terrain, with the cuboid around it.

    Args:
        terrain: on which it lies, in the same coordinates.
        thickness: vertical [m]; one inside the outline, or a raster.
        outline: as of `Release`.
        velocity: initial [3] [m/s].
        material: name of its material.

    Raises:
        InputError: one that lies, in part, where there is no ground.
    """
    if isinstance(thickness, Raster):
        covered = np.argwhere(np.nan_to_num(thickness.values) > 0)
        if len(covered) == 0:
            raise InputError("release: its raster of thicknesses holds none above 0.")
        start, stop = covered.min(axis=0), covered.max(axis=0) + 1
        corner = tuple(
            first + thickness.cell * int(index) for first, index in zip(thickness.corner, start, strict=True)
        )
        values = thickness.values[tuple(map(slice, start, stop))]
        thickness = Raster(values, corner, thickness.cell, thickness.crs)
        lower, upper = thickness.extent
        most = float(np.nanmax(values))
    else:
        most = checked_number("release", "thickness", thickness, 0.0, above=True)
        outline = checked_rings(outline)
        corners = np.array([corner for ring in outline for corner in ring]).reshape(-1, 2)
        if len(corners) == 0:
            raise InputError("release: one thickness needs an outline, and there is none.")
        lower, upper = tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())
    if not terrain.covers(lower, upper):
        raise InputError(
            f"release: it reaches {described(lower, upper)}, and the terrain {described(*terrain.extent)}; both "
            "must be in one system of coordinates, in metres."
        )
    heights = terrain.cropped(lower, upper).heights
    low, high = float(heights.min()), float(heights.max()) + most
    size = (*(b - a for a, b in zip(lower, upper, strict=True)), high - low)
    return Release((*lower, low), size, tuple(velocity), material, thickness, outline)


def checked_rings(rings: Any) -> Rings:
    """Return rings of corners, none closed by its first corner again, or raise an `InputError`."""
    try:
        checked = tuple(tuple(checked_numbers("release", "outline", corner, 2) for corner in ring) for ring in rings)
    except TypeError:
        raise InputError("release: an outline is a list of rings, each a list of corners [x, y].") from None
    opened = tuple(ring[:-1] if len(ring) > 1 and ring[0] == ring[-1] else ring for ring in checked)
    if any(len(ring) < 3 for ring in opened):
        raise InputError("release: a ring of its outline needs three corners at least.")
    return opened  # type: ignore[return-value]


def read_outline(path: str | Path) -> Rings:
    """Read the polygons of a GeoJSON file, in the coordinates of the terrain.

    Raises:
        InputError: no such file, or none with polygons.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise InputError(f"{path}: is not GeoJSON.") from None
    polygons = list(_polygons(data))
    if not polygons:
        raise InputError(f"{path}: holds no polygon.")
    try:
        return checked_rings([[corner[:2] for corner in ring] for polygon in polygons for ring in polygon])
    except (TypeError, InputError) as error:
        raise InputError(f"{path}: {error}") from None


def _polygons(data: Any) -> Any:
    """Yield the lists of rings in GeoJSON of any kind."""
    if not isinstance(data, dict):
        return
    kind = data.get("type")
    if kind == "Polygon":
        yield data.get("coordinates", ())
    elif kind == "MultiPolygon":
        yield from data.get("coordinates", ())
    inner = [data.get("geometry"), *data.get("features", ()), *data.get("geometries", ())]
    for part in inner:
        yield from _polygons(part)


def is_inside(places: Floats, rings: Sequence[Floats]) -> NDArray[np.bool_]:
    """Tell which places [N, 2] lie in an odd number of rings [_, 2], whose edges a ray along x crosses so often."""
    inside = np.zeros(len(places), dtype=bool)
    x, y = places.T
    for ring in rings:
        for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            if ay != by:
                crosses = (ay > y) != (by > y)
                inside ^= crosses & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return inside
