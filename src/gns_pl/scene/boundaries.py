"""What material runs against: the walls of the box, and obstacles fixed inside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gns_pl.errors import InputError
from gns_pl.scene.checks import checked_number, checked_numbers

WALL_CONDITIONS = {
    "stick": False,
    "slip": False,
    "friction": True,
}
"""What a face may do to the material → whether it has a coefficient. `mpm.walls` has the laws."""


@dataclass(frozen=True)
class Wall:
    """What a face of the box does to the material at it.

    Attributes:
        condition: "stick" (no motion), "slip" (no motion through it) or "friction" (Coulomb).
        friction: coefficient μ of Coulomb friction; only with "friction", or another condition that has a coefficient.
    """

    condition: str
    friction: float = 0.0

    def __post_init__(self) -> None:
        if self.condition not in WALL_CONDITIONS:
            raise InputError(f"wall: condition must be one of {', '.join(WALL_CONDITIONS)}, not {self.condition!r}.")
        object.__setattr__(self, "friction", checked_number("wall", "friction", self.friction, 0.0))
        if self.friction and not WALL_CONDITIONS[self.condition]:
            raise InputError(f'wall: friction {self.friction} needs condition "friction", not "{self.condition}".')

    @property
    def description(self) -> str:
        """The condition, with the coefficient where it has one."""
        return f"{self.condition} {self.friction:g}" if WALL_CONDITIONS[self.condition] else self.condition


@dataclass(frozen=True)
class Plane:
    """A half-space that holds nothing: a sloping floor, a ramp, an inclined wall.

    Attributes:
        point: any point of its surface [D] [m].
        normal: direction from the surface to the free side [D]; made a unit vector here.
        wall: what the surface does to material at it.
    """

    kind: ClassVar[str] = "plane"
    point: tuple[float, ...]
    normal: tuple[float, ...]
    wall: Wall

    def __post_init__(self) -> None:
        for name in ("point", "normal"):
            object.__setattr__(self, name, checked_numbers("plane", name, getattr(self, name)))
        length = math.hypot(*self.normal)
        if length == 0:
            raise InputError("plane: normal must point somewhere, so it cannot be zero.")
        if (
            abs(length - 1) > 1e-12
        ):  # dividing twice would change the last bits, and a stored scene must come back equal
            object.__setattr__(self, "normal", tuple(component / length for component in self.normal))


@dataclass(frozen=True)
class Box:
    """A fixed cuboid: a barrier, a step, a building.

    Attributes:
        position: lower corner [D] [m].
        size: edge lengths [D] [m].
        wall: what its faces do to material at them.
    """

    kind: ClassVar[str] = "box"
    position: tuple[float, ...]
    size: tuple[float, ...]
    wall: Wall

    def __post_init__(self) -> None:
        for name in ("position", "size"):
            object.__setattr__(self, name, checked_numbers("box", name, getattr(self, name)))
        if min(self.size, default=0.0) <= 0:
            raise InputError(f"box: size must be positive along every axis, not {list(self.size)}.")

    @property
    def upper(self) -> tuple[float, ...]:
        """Upper corner [D] [m]."""
        return tuple(p + s for p, s in zip(self.position, self.size, strict=True))


Obstacle: TypeAlias = Plane | Box
"""What stands in the box: a half-space or a block that no sand enters."""


def signed_distance(obstacle: Obstacle, position: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance of points from an obstacle's surface and the direction away from it.

    Args:
        obstacle: a plane or a box.
        position: [N, D] [m].

    Returns:
        Distance [N] [m], positive on the free side; inside a box minus the distance to its nearest face. Unit normal
        [N, D] in which the distance grows fastest; where several faces are equally near, that of the first axis.
    """
    places = np.asarray(position, dtype=np.float64)
    if isinstance(obstacle, Plane):
        direction = np.array(obstacle.normal)
        return (places - obstacle.point) @ direction, np.tile(direction, (len(places), 1))
    below, above = obstacle.position - places, places - obstacle.upper
    side = np.where(below > above, -1.0, 1.0)
    beyond = np.maximum(below, above)  # the nearer face of each axis, negative between the two
    outside = np.maximum(beyond, 0.0)
    distance = np.linalg.norm(outside, axis=1)
    inside = distance == 0
    nearest = beyond.argmax(axis=1)
    normal = side * np.where(inside[:, None], np.eye(places.shape[1])[nearest], outside)
    normal[~inside] /= distance[~inside, None]
    return np.where(inside, beyond.max(axis=1), distance), normal
