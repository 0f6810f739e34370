"""The frozen `Scene` and its parts, checked at construction."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene.arrays import encoded_array
from gns_pl.scene.boundaries import Obstacle, Plane, Wall, signed_distance
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.outlines import check_outline
from gns_pl.scene.raster import described
from gns_pl.scene.terrain import Terrain

if TYPE_CHECKING:
    from gns_pl.scene.release import Release

AXES = {2: "xz", 3: "xyz"}
"""Names of the axes by dimension; the last one is vertical."""

FACES = {dim: tuple(f"{axis}{side}" for axis in axes for side in "-+") for dim, axes in AXES.items()}
"""Names of the faces of the box by dimension: lower and upper face of each axis in turn."""


@dataclass(frozen=True)
class Material:
    """A Mohr–Coulomb sand.

    Attributes:
        density: bulk density [kg/m³].
        youngs_modulus: Young's modulus [Pa].
        poisson_ratio: Poisson's ratio, −1 < ν < 0.5.
        friction_angle_deg: angle of internal friction φ [degrees].
        dilation_angle_deg: dilation angle ψ [degrees].
        cohesion: cohesion c [Pa].
        tension_cutoff: largest mean tension [Pa]; never above the apex of the cone, c / tan φ.
    """

    density: float
    youngs_modulus: float
    poisson_ratio: float
    friction_angle_deg: float
    dilation_angle_deg: float = 0.0
    cohesion: float = 0.0
    tension_cutoff: float = 0.0

    def __post_init__(self) -> None:
        for name in ("density", "youngs_modulus"):
            object.__setattr__(self, name, checked_number("material", name, getattr(self, name), 0.0, above=True))
        for name in ("friction_angle_deg", "dilation_angle_deg", "cohesion", "tension_cutoff"):
            object.__setattr__(self, name, checked_number("material", name, getattr(self, name), 0.0))
        ratio = checked_number("material", "poisson_ratio", self.poisson_ratio, -1.0, above=True)
        object.__setattr__(self, "poisson_ratio", ratio)
        if ratio >= 0.5:
            raise InputError(f"material: poisson_ratio must be below 0.5, not {ratio}.")
        if self.friction_angle_deg >= 90:
            raise InputError(f"material: friction_angle_deg must be below 90, not {self.friction_angle_deg}.")
        if self.dilation_angle_deg > self.friction_angle_deg:
            raise InputError("material: dilation_angle_deg must not exceed friction_angle_deg.")

    @property
    def tan_friction_angle(self) -> float:
        """Coefficient of internal friction, tan φ."""
        return math.tan(math.radians(self.friction_angle_deg))

    @property
    def oedometric_modulus(self) -> float:
        """Stiffness against compression that cannot spread sideways, M = E (1 − ν) / ((1 + ν)(1 − 2 ν)) [Pa]."""
        nu = self.poisson_ratio
        return self.youngs_modulus * (1 - nu) / ((1 + nu) * (1 - 2 * nu))

    @property
    def p_wave_speed(self) -> float:
        """Speed of elastic compression waves √(M/ρ) [m/s], with M the oedometric modulus."""
        return math.sqrt(self.oedometric_modulus / self.density)


@dataclass(frozen=True)
class Body:
    """A cuboid of one material.

    Attributes:
        position: lower corner [D] [m].
        size: edge lengths [D] [m].
        velocity: initial velocity [D] [m/s].
        material: name of its material in the scene.
    """

    needs_terrain: ClassVar[bool] = False
    position: tuple[float, ...]
    size: tuple[float, ...]
    velocity: tuple[float, ...]
    material: str = "sand"

    def __post_init__(self) -> None:
        for name in ("position", "size", "velocity"):
            object.__setattr__(self, name, checked_numbers("body", name, getattr(self, name)))
        if min(self.size, default=0.0) <= 0:
            raise InputError(f"body: size must be positive along every axis, not {list(self.size)}.")

    @property
    def upper(self) -> tuple[float, ...]:
        """Upper corner [D] [m]."""
        return tuple(p + s for p, s in zip(self.position, self.size, strict=True))

    @property
    def height(self) -> float:
        """Vertical extent of its material [m]."""
        return self.size[-1]

    @property
    def volume(self) -> float:
        """Volume of its material [m³], or [m²] in two dimensions."""
        return math.prod(self.size)

    def overlaps(self, other: Body) -> bool:
        """Tell whether its inside meets that of another body; touching faces do not count."""
        return _overlap(self.position, self.upper, other.position, other.upper)

    def corners(self) -> NDArray[np.float64]:
        """Return its corners [2^D, D] [m]."""
        edges = [np.array(pair) for pair in zip(self.position, self.upper, strict=True)]
        return np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, len(edges))


@dataclass(frozen=True)
class Scene:
    """A box with bodies in it, what they are made of, and how long to watch them.

    Attributes:
        name: a word for file names and figures.
        lower: lower corner of the box [D] [m].
        upper: upper corner of the box [D] [m].
        gravity: acceleration of gravity [D] [m/s²]; its main direction is the last axis.
        duration: simulated time [s].
        materials: name → `Material`.
        bodies: the bodies, none touching another's inside.
        walls: face ("x-", "x+", …, "z+") → `Wall`, every face of the box.
        obstacles: what stands fixed in the box. Bodies may reach into them and are then carved when they are filled.
        origin: where this scene's zero lies in the coordinates it came from, as those of a map [D] [m]; zero if nothing
            is said. No computation uses it; it is added where coordinates leave (`scene.origin`).
        terrain: the ground, a heightfield that carves bodies as obstacles do; None where the floor of the box is all.

    Raises:
        InputError: anything inconsistent, in one sentence.
    """

    name: str
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    gravity: tuple[float, ...]
    duration: float
    materials: Mapping[str, Material]
    bodies: tuple[Body, ...]
    walls: Mapping[str, Wall]
    obstacles: tuple[Obstacle, ...] = ()
    origin: tuple[float, ...] = ()
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or {"/", "\\", "\0"} & set(self.name):
            raise InputError(f"scene: name must be a word that can stand in a file name, not {self.name!r}.")
        owner = f"scene {self.name!r}"
        object.__setattr__(self, "lower", checked_numbers(owner, "lower", self.lower))
        dim = len(self.lower)
        if dim not in AXES:
            raise InputError(f"{owner}: a domain has 2 or 3 dimensions, not {dim}.")
        object.__setattr__(self, "upper", checked_numbers(owner, "upper", self.upper, dim))
        object.__setattr__(self, "gravity", checked_numbers(owner, "gravity", self.gravity, dim))
        object.__setattr__(self, "origin", checked_numbers(owner, "origin", self.origin or (0.0,) * dim, dim))
        object.__setattr__(self, "duration", checked_number(owner, "duration", self.duration, 0.0, above=True))
        object.__setattr__(self, "bodies", tuple(self.bodies))
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise InputError(
                f"{owner}: upper {list(self.upper)} must lie above lower {list(self.lower)} on every axis."
            )
        if sorted(self.walls) != sorted(FACES[dim]):
            raise InputError(
                f"{owner}: walls must name the faces {', '.join(FACES[dim])}, not {', '.join(self.walls)}."
            )
        if not self.bodies:
            raise InputError(f"{owner}: needs at least one body.")
        for index, obstacle in enumerate(self.obstacles):
            self._check_obstacle(f"{owner}, obstacle {index}", obstacle)
        if self.terrain is not None:
            self._check_terrain(owner, self.terrain)
        for index, body in enumerate(self.bodies):
            self._check_body(f"{owner}, body {index}", body)
            for other_index, other in enumerate(self.bodies[:index]):
                if body.overlaps(other) and other.overlaps(body):
                    raise InputError(f"{owner}: bodies {other_index} and {index} overlap; move one of them.")

    def _check_obstacle(self, owner: str, obstacle: Obstacle) -> None:
        for name in ("point", "normal") if isinstance(obstacle, Plane) else ("position", "size"):
            checked_numbers(owner, name, getattr(obstacle, name), self.dim)
        if not isinstance(obstacle, Plane) and not _overlap(obstacle.position, obstacle.upper, self.lower, self.upper):
            raise InputError(
                f"{owner}: it reaches from {_rounded(obstacle.position)} to {_rounded(obstacle.upper)} and is nowhere "
                f"in the domain {_rounded(self.lower)} to {_rounded(self.upper)}."
            )

    def _check_terrain(self, owner: str, terrain: Terrain) -> None:
        lower, upper = self.lower[:-1], self.upper[:-1]
        if not isinstance(terrain, Terrain) or terrain.heights.ndim != self.dim - 1:
            raise InputError(
                f"{owner}: a terrain has heights along {self.dim - 1} axes where the domain has {self.dim}."
            )
        if not terrain.covers(lower, upper):
            raise InputError(
                f"{owner}: the domain reaches {described(lower, upper)}, and the terrain {described(*terrain.extent)}; "
                "choose a domain on it."
            )
        heights = terrain.cropped(lower, upper).heights
        if not (self.lower[-1] < heights.max() and heights.max() < self.upper[-1]):
            raise InputError(
                f"{owner}: the ground reaches up to {heights.max():.6g} m, which must lie between the floor at "
                f"{self.lower[-1]:.6g} and the lid at {self.upper[-1]:.6g} m."
            )

    def _check_body(self, owner: str, body: Body) -> None:
        for name in ("position", "size", "velocity"):
            checked_numbers(owner, name, getattr(body, name), self.dim)
        if body.material not in self.materials:
            raise InputError(f"{owner}: material {body.material!r} is not among {', '.join(self.materials) or 'none'}.")
        tolerance = 1e-9 * max(high - low for low, high in zip(self.lower, self.upper, strict=True))
        inside = all(
            low - tolerance <= start and end <= high + tolerance
            for low, start, end, high in zip(self.lower, body.position, body.upper, self.upper, strict=True)
        )
        if not inside:
            raise InputError(
                f"{owner}: it reaches from {_rounded(body.position)} to {_rounded(body.upper)}, outside the domain "
                f"{_rounded(self.lower)} to {_rounded(self.upper)}."
            )
        for index, obstacle in enumerate(self.obstacles):
            if (signed_distance(obstacle, body.corners())[0] <= 0).all():  # obstacles are convex
                raise InputError(f"{owner}: it lies entirely inside obstacle {index}; move one of them.")
        if body.needs_terrain and self.terrain is None:
            raise InputError(f"{owner}: a release lies on a terrain, and the scene has none; give one, or a body.")
        if body.needs_terrain:
            check_outline(owner, cast("Release", body))
        if self.terrain is not None:
            shares = (np.indices((33,) * (self.dim - 1)).reshape(self.dim - 1, -1).T + 0.5) / 33
            ground = self.terrain.height(np.array(body.position[:-1]) + shares * body.size[:-1])
            if (ground >= body.upper[-1]).all():
                raise InputError(
                    f"{owner}: it starts inside the ground, {ground.min() - body.upper[-1]:.3g} m deep; raise it."
                )

    @property
    def dim(self) -> int:
        """Dimension D, 2 or 3."""
        return len(self.lower)

    def replace(self, **changes: Any) -> Scene:
        """Return a copy with some attributes changed, checked again."""
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as plain dicts, lists, numbers and strings; `scene_from_dict` is its inverse.

        An origin of zero, and no terrain, are left out, so that files of scenes without are as they always were.
        Heights become a string, exact to the bit (`scene.arrays`).
        """
        listed: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(self), default=encoded_array))
        for obstacle, entry in zip(self.obstacles, listed["obstacles"], strict=True):
            entry["kind"] = obstacle.kind
        if not any(self.origin):
            del listed["origin"]
        if self.terrain is None:
            del listed["terrain"]
        return listed


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(value, 6) for value in values]


def _overlap(
    lower: tuple[float, ...], upper: tuple[float, ...], other_lower: tuple[float, ...], other_upper: tuple[float, ...]
) -> bool:
    """True if the insides of two cuboids meet; touching faces do not count."""
    gap = 1e-9
    return all(
        low + gap < other_high and other_low + gap < high
        for low, high, other_low, other_high in zip(lower, upper, other_lower, other_upper, strict=True)
    )
