"""Terrains by a formula, for scenes of a few numbers: a slope that runs out, with a gully or a mound, and a bowl.

Heights are rounded, so that a scene is the same to the bit on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.parts import part_from_dict
from gns_pl.scene.raster import Raster
from gns_pl.text import did_you_mean

Floats = NDArray[np.float64]

DIGITS = 6
"""Decimal places of heights [m]."""

STEEPEST_DEG = 60.0
"""Steepest slope of a shape [degrees]; no solver runs steeper ground."""


@dataclass(frozen=True)
class Slope:
    """A slope down along x that bends, as an arc, into a gentler one.

    Attributes:
        slope_deg: at x = 0 [degrees].
        toe: where it begins to bend, and over what length along x it does [m].
        runout_deg: beyond [degrees].
        gully: depth and width of a gully along the slope, a cosine across, which ends where the bend does [m].
        bend: how far the gully's line swings to either side on its way, a sine [m].
        mound: x, y, height and radius of a mound, a Gaussian hill, in the way [m].
    """

    slope_deg: float
    toe: Sequence[float]
    runout_deg: float = 0.0
    gully: Sequence[float] = (0.0, 1.0)
    bend: float = 0.0
    mound: Sequence[float] = (0.0, 0.0, 0.0, 1.0)

    def heights(self, x: Floats, y: Floats, width: float) -> Floats:
        """Return heights [X, Y] [m] at x [X, 1] and y [1, Y] from the lower corner, `width` the terrain's along y."""
        (start, length), (depth, wide) = (checked_numbers("terrain", *each, 2) for each in self._pairs())
        steep, gentle = (tangent(name, getattr(self, name)) for name in ("slope_deg", "runout_deg"))
        checked_number("terrain", "toe", length, 0.0, above=True)
        checked_number("terrain", "gully", wide, 0.0, above=True)
        bent = np.clip(x - start, 0.0, length)
        fall = steep * np.minimum(x, start) + steep * bent - (steep - gentle) * bent**2 / (2 * length)
        fall = fall + gentle * np.maximum(x - start - length, 0.0)
        line = width / 2 + self.bend * np.sin(2 * np.pi * x / (start + length))
        across = np.clip(2 * np.abs(y - line) / wide, 0.0, 1.0)
        ends = np.clip((start + length - x) / length, 0.0, 1.0)
        left, up, height, radius = checked_numbers("terrain", "mound", self.mound, 4)
        checked_number("terrain", "mound", radius, 0.0, above=True)
        hill = height * np.exp(-((x - left) ** 2 + (y - up) ** 2) / radius**2)
        return np.asarray(hill - fall - depth * ends * (1 + np.cos(np.pi * across)) / 2)

    def _pairs(self) -> tuple[tuple[str, Any], tuple[str, Any]]:
        return ("toe", self.toe), ("gully", self.gully)


@dataclass(frozen=True)
class Bowl:
    """A cone that stands on its rounded tip.

    Attributes:
        slope_deg: far from the middle [degrees].
        centre: of the bowl, x and y [m].
        rounding: distance from the middle within which it is round [m].
    """

    slope_deg: float
    centre: Sequence[float]
    rounding: float

    def heights(self, x: Floats, y: Floats, width: float) -> Floats:
        """Return heights; arguments as those of `Slope.heights`."""
        left, up = checked_numbers("terrain", "centre", self.centre, 2)
        rounding = checked_number("terrain", "rounding", self.rounding, 0.0, above=True)
        distance = np.sqrt((x - left) ** 2 + (y - up) ** 2 + rounding**2)
        return np.asarray(tangent("slope_deg", self.slope_deg) * (distance - rounding))


SHAPES: dict[str, type[Slope] | type[Bowl]] = {"slope": Slope, "bowl": Bowl}
"""Name → its numbers."""


def tangent(name: str, degrees: Any) -> float:
    """Return the tangent of a slope.

    Raises:
        InputError: one beyond `STEEPEST_DEG`.
    """
    angle = checked_number("terrain", name, degrees)
    if abs(angle) > STEEPEST_DEG:
        raise InputError(f"terrain: {name} must lie within ± {STEEPEST_DEG:g}°, not {angle:g}.")
    return math.tan(math.radians(angle))


def shaped_raster(data: Mapping[str, Any]) -> Raster:
    """Return heights by a formula; the lowest is 0, the lower corner of the first cell at zero.

    Args:
        data: "shape" (a key of `SHAPES`), "size" along x and y [m], "cell" [m], and the numbers of the shape.

    Raises:
        InputError: another shape, unknown or missing keys, or numbers that make none.
    """
    numbers = {key: value for key, value in data.items() if key not in ("shape", "size", "cell")}
    name = data["shape"]
    if name not in SHAPES:
        raise InputError(
            f"terrain: shape must be one of {', '.join(SHAPES)}, not {name!r}{did_you_mean(name, SHAPES)}."
        )
    shape = part_from_dict(SHAPES[name], f"terrain, a {name}", numbers)
    cell = checked_number("terrain", "cell", data.get("cell"), 0.0, above=True)
    size = checked_numbers("terrain", "size", data.get("size"), 2)
    counts = [round(edge / cell) for edge in size]
    if min(counts) < 2:
        raise InputError(
            f"terrain: a size of {size[0]:g} × {size[1]:g} m has no two cells of {cell:g} m along each axis."
        )
    x, y = ((np.arange(number) + 0.5) * cell for number in counts)
    heights = shape.heights(x[:, None], y[None, :], counts[1] * cell) + np.zeros(counts)
    return Raster(np.round(heights - heights.min(), DIGITS), (cell / 2, cell / 2), cell)
