"""What the colour of a grain means in the figures: its displacement, or its material where a scene has several."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from gns_pl.fields import ParticleType
from gns_pl.trajectory import Trajectory
from gns_pl.viz.raster import colour_map, displacement, displacement_limit

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap

MATERIALS = ("#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
"""One per material: Okabe and Ito's palette."""

GREY = "#8C8C8C"
"""Of kinematic particles, which are obstacles, and of those of no known material."""

OUTSIDE = -1.0
"""Value of what is grey."""


@dataclass(frozen=True)
class Colouring:
    """How grains are coloured, the same for all trajectories of a figure.

    Attributes:
        names: of the materials; empty where the colour is the displacement.
        limit: upper end of the scale of displacements [m].
    """

    names: tuple[str, ...]
    limit: float

    @classmethod
    def of(cls, reference: Trajectory) -> Colouring:
        """Return the colouring of a figure whose reference this is."""
        return cls(material_names(reference), displacement_limit(reference))

    def shares(self, trajectory: Trajectory, frame: int) -> NDArray[np.float64]:
        """Return where every particle is on the scale, from 0 to 1, or `OUTSIDE` [N]."""
        if self.names:
            number = material_numbers(trajectory, self.names)
            share = np.where(number < 0, OUTSIDE, (number + 0.5) / len(self.names))
        else:
            share = np.clip(displacement(trajectory, frame) / self.limit, 0, 1)
        return np.where(trajectory.particle_type == ParticleType.KINEMATIC, OUTSIDE, share)

    def pixels(self, trajectory: Trajectory, frame: int) -> NDArray[np.uint8]:
        """Return the colours of the particles of a frame [N, 3]."""
        colours = np.asarray(self.colour_map()(self.shares(trajectory, frame)))[:, :3]
        return np.asarray((255 * colours).round(), dtype=np.uint8)

    def colour_map(self) -> ListedColormap:
        """Return the colours of shares, grey below 0."""
        from matplotlib.colors import ListedColormap

        colours = ListedColormap(MATERIALS[: len(self.names)]) if self.names else colour_map()
        return cast("ListedColormap", colours.with_extremes(under=GREY))

    def legend(self) -> list[tuple[str, str]]:
        """Return name and colour of every material."""
        return list(zip(self.names, MATERIALS, strict=False))


def material_names(trajectory: Trajectory) -> tuple[str, ...]:
    """Return the names of a trajectory's materials, those of its bodies; none if there is only one, or too many.

    Where bodies do not tell them apart, as in imported data, sands are named after their angles of friction.
    """
    names = tuple(dict.fromkeys(body.material for body in trajectory.scene.bodies))
    if len(names) < 2:
        names = tuple(_angle(value) for value in np.unique(_friction(trajectory)) if np.isfinite(value))
    return names if 2 <= len(names) <= len(MATERIALS) else ()


def material_numbers(trajectory: Trajectory, names: tuple[str, ...]) -> NDArray[np.int64]:
    """Return the number in `names` of every particle's material, −1 where it has none of these [N]."""
    number, start = np.full(trajectory.num_particles, -1, dtype=np.int64), trajectory.position[0].astype(np.float64)
    for margin in (1e-6, 0.5):  # of a spacing: single precision, then what was placed a little outside its body
        for body in trajectory.scene.bodies:
            if body.material in names:
                beyond = np.maximum(body.position - start, start - body.upper).max(axis=1)
                number[(number < 0) & (beyond <= margin * trajectory.spacing)] = names.index(body.material)
    friction = _friction(trajectory)
    for value in np.unique(friction[np.isfinite(friction)]):
        if _angle(value) in names:
            number[friction == value] = names.index(_angle(value))
    return number


def _friction(trajectory: Trajectory) -> NDArray[np.float64]:
    """Return tan φ of every particle, rounded [N]; NaN where it is not known, and for kinematic particles."""
    if "tan_friction_angle" not in trajectory.material_features:
        return np.full(trajectory.num_particles, np.nan)
    column = trajectory.material[:, trajectory.material_features.index("tan_friction_angle")].astype(np.float64)
    return np.where(trajectory.particle_type == ParticleType.KINEMATIC, np.nan, column.round(4))


def _angle(tangent: float) -> str:
    return f"φ = {math.degrees(math.atan(tangent)):.3g}°"
