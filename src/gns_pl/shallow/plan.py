"""From a scene to a grid: the bed that floor, planes, boxes and a tilt of gravity make, its friction, and the layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gns_pl.scene import Body, Plane, Release, Scene, Wall
from gns_pl.shallow.config import ShallowConfig
from gns_pl.shallow.terrain import CLIFF, STEEPEST_DEG, terrain_curve, terrain_height

Floats = NDArray[np.float64]

STEEPEST = math.cos(math.radians(STEEPEST_DEG))
"""Least vertical component of a plane's normal, and least share of gravity along the last axis."""

GAP = 1e-6
"""Bodies and boxes no farther above what is under them stand on it [m]."""


@dataclass(frozen=True)
class Grid:
    """Cells of the horizontal plane; one along y in two dimensions. Arrays of all cells are flat, y running fastest.

    Attributes:
        edges: of the cells along x [NX + 1] and y [NY + 1] [m]; 0 and 1 along y in two dimensions.
    """

    edges: tuple[Floats, Floats]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along x and y."""
        return len(self.edges[0]) - 1, len(self.edges[1]) - 1

    @property
    def sizes(self) -> tuple[float, float]:
        """Edges of a cell along x and y, where all are equal [m]."""
        x, y = ((edges[-1] - edges[0]) / (len(edges) - 1) for edges in self.edges)
        return float(x), float(y)

    @property
    def centres(self) -> tuple[Floats, Floats]:
        """Middles of all cells, x [C] and y [C] [m]."""
        x, y = np.meshgrid(*((edges[1:] + edges[:-1]) / 2 for edges in self.edges), indexing="ij")
        return x.ravel(), y.ravel()

    def coverage(self, lower: Sequence[float], upper: Sequence[float]) -> Floats:
        """Return which share of every cell a rectangle covers [C]."""
        shares = [
            np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], start), 0.0, None) / np.diff(edges)
            for edges, start, end in zip(self.edges, lower, upper, strict=True)
        ]
        return np.asarray(np.outer(*shares).ravel())

    def parents(self, other: Grid) -> NDArray[np.int64]:
        """Return which cell of this grid each cell of another one lies in [C]."""
        places = [
            np.clip(np.searchsorted(edges, place, side="right") - 1, 0, len(edges) - 2)
            for edges, place in zip(self.edges, other.centres, strict=True)
        ]
        return np.asarray(places[0] * self.shape[1] + places[1])


@dataclass(frozen=True)
class Ground:
    """What the layer flows over.

    Attributes:
        height: of the bed where particles stand on it [C] [m].
        bed: the same as the equations have it: with the tilt of gravity, slopes over the earth pressure [C] [m].
        gravity: k g cos²θ, θ the slope of a plane [C] [m/s²].
        friction: tan δ / k [C].
        curve: slopes along x and y of a terrain, the second derivatives xx, xy and yy of its height [1/m], and by how
            much the beds of neighbours may miss each other [m] (`terrain.terrain_curve`) [C, 6]; without one [0, 6].
        drag: g / (ξ cos²θ), Voellmy's [C]; without [0].
        cliff: rise of the bed from one cell to the next, in cells, beyond which it is a step and no slope.
    """

    height: Floats
    bed: Floats
    gravity: Floats
    friction: Floats
    curve: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    drag: Floats = field(default_factory=lambda: np.zeros(0))
    cliff: float = CLIFF


def make_grid(scene: Scene, cell_size: float) -> Grid:
    """Divide the floor of the box into equal cells."""
    edges = []
    for low, high in zip(scene.lower[:-1], scene.upper[:-1], strict=True):
        edges.append(np.linspace(low, high, max(1, round((high - low) / cell_size)) + 1))
    return Grid((edges[0], edges[1] if scene.dim == 3 else np.array([0.0, 1.0])))


def with_bodies(scene: Scene, grid: Grid) -> Grid:
    """Return a grid with the edges of the bodies besides its own, so that no cell is covered in part."""
    edges = list(grid.edges)
    for axis in range(scene.dim - 1):
        boxes = [body for body in scene.bodies if not isinstance(body, Release)]
        ends = [end[axis] for body in boxes for end in (body.position, body.upper)]
        edges[axis] = np.unique(np.clip([*edges[axis], *ends], edges[axis][0], edges[axis][-1]))
        edges[axis] = edges[axis][np.append(True, np.diff(edges[axis]) > GAP)]
    return Grid((edges[0], edges[1]))


def unsupported_reason(scene: Scene) -> str | None:
    """Return why depth-averaged flow cannot run a scene, a sentence; None if it can."""
    down = -scene.gravity[-1]
    if down <= 0 or down < STEEPEST * math.hypot(*scene.gravity):
        return "depth-averaged flow needs gravity within 60° of the last axis, pointing down it."
    for index, obstacle in enumerate(scene.obstacles):
        if isinstance(obstacle, Plane):
            if obstacle.normal[-1] < STEEPEST:
                return f"depth-averaged flow needs slopes below 60°, and obstacle {index} is steeper or overhangs."
        elif obstacle.position[-1] > scene.lower[-1] + GAP:
            return f"depth-averaged flow has no room under a box, and obstacle {index} stands above the floor."
    if len({scene.materials[body.material].density for body in scene.bodies}) > 1:
        return "depth-averaged flow has one density, and the bodies differ in theirs."
    strengths = [scene.materials[body.material].tan_friction_angle for body in scene.bodies]
    walls = [scene.walls["z-"], *(obstacle.wall for obstacle in scene.obstacles)]
    walls += [scene.terrain.wall] if scene.terrain is not None else []
    if any(floor_friction(wall, min(strengths)) != floor_friction(wall, max(strengths)) for wall in walls):
        return "depth-averaged flow has one friction on a floor, and the bodies' friction angles would give several."
    for index, body in enumerate(scene.bodies):
        if body.velocity[-1] != 0:
            return f"depth-averaged flow has no vertical velocity, and body {index} has one."
        gap = _gap(scene, body)
        if gap > GAP:
            return f"depth-averaged flow cannot fall, and body {index} starts {gap:.3g} m above what is under it."
    return None


def floor_friction(wall: Wall, strength: float) -> float:
    """Return tan δ of a floor: that of its wall, at most the material's own tan φ, which a sticking floor mobilises."""
    if wall.condition == "stick":
        return strength
    return min(wall.friction, strength)


def make_ground(scene: Scene, grid: Grid, config: ShallowConfig) -> Ground:
    """Return the bed and its friction.

    Obstacles are known at the middles of cells. A tilt of gravity is a slope of the bed. With an earth pressure k the
    layer's surface pushes with k times its weight and slopes with its whole weight: divided by k, slopes leave one
    pressure for all. The height of boxes, which decides what flows over them, stays.
    """
    strength = min(scene.materials[body.material].tan_friction_angle for body in scene.bodies)
    x, y = grid.centres
    height = np.full(len(x), scene.lower[-1])
    flatness = np.ones(len(x))
    friction = np.full(len(x), floor_friction(scene.walls["z-"], strength))
    curve = np.zeros((0, 6))
    if scene.terrain is not None:
        surface = terrain_height(scene, grid)
        height, curve = np.maximum(surface.ravel(), height), terrain_curve(surface, grid, config.earth_pressure)
        curve[surface.ravel() < height] = 0.0
        flatness = 1.0 / (1.0 + curve[:, 0] ** 2 + curve[:, 1] ** 2)
        friction[surface.ravel() >= height] = floor_friction(scene.terrain.wall, strength)
    for plane in (obstacle for obstacle in scene.obstacles if isinstance(obstacle, Plane)):
        surface = plane_height(plane, x, y)
        above = surface > height
        height[above] = surface[above]
        flatness[above] = plane.normal[-1] ** 2
        curve[above[: len(curve)]] = 0.0
        friction[above] = floor_friction(plane.wall, strength)
    slopes = height.copy()
    for axis, place in enumerate((x, y)[: scene.dim - 1]):
        slopes += scene.gravity[axis] / scene.gravity[-1] * (place - scene.lower[axis])
    base = height.copy()
    for box in (obstacle for obstacle in scene.obstacles if not isinstance(obstacle, Plane)):
        inside = np.ones(len(x), dtype=bool)
        for axis, place in enumerate((x, y)[: scene.dim - 1]):
            inside &= (place >= box.position[axis]) & (place <= box.upper[axis])
        above = inside & (box.upper[-1] > height)
        height[above] = box.upper[-1]
        flatness[above] = 1.0
        curve[above[: len(curve)]] = 0.0
        friction[above] = floor_friction(box.wall, strength)
    if config.friction is not None:
        friction[:] = config.friction
    k = config.earth_pressure
    gravity = -scene.gravity[-1] * k * flatness
    drag = np.zeros(0) if config.turbulence is None else -scene.gravity[-1] / (config.turbulence * flatness)
    bed = slopes / k + (height - base)
    cliff = CLIFF if scene.terrain is None else CLIFF / min(k, 1.0)  # slopes of the bed are over k
    return Ground(height, bed, gravity, config.friction_factor * friction / k, curve, drag, cliff)


def make_layer(scene: Scene, grid: Grid, height: Floats, rain: float | None) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the layer at the start.

    Args:
        scene: its bodies.
        grid: the cells.
        height: of the bed, on which bodies stand and by which they are carved [C] [m].
        rain: height over length of what stands at the start; None for all of it.

    Returns:
        Thickness that stands [C] [m], momentum along x and y [C] [m²/s], thickness that rains [C] [m].
    """
    layer, qx, qy, falling = (np.zeros(len(height)) for _ in range(4))
    for body in scene.bodies:
        if isinstance(body, Release):
            thickness = body.means(grid.edges).ravel()
            layer += thickness
            qx += thickness * body.velocity[0]
            qy += thickness * body.velocity[1]
            continue
        lower, upper = (*body.position[:-1], 0.0)[:2], (*body.upper[:-1], 1.0)[:2]
        cover = grid.coverage(lower, upper)
        thickness = np.maximum(body.upper[-1] - np.maximum(height, body.position[-1]), 0.0)
        length = spreading_length(scene, body)
        stands = thickness if rain is None else np.minimum(thickness, max(rain * length - body.position[-1], 0.0))
        layer += cover * stands
        falling += cover * (thickness - stands)
        qx += cover * stands * body.velocity[0]
        qy += cover * stands * (body.velocity[1] if scene.dim == 3 else 0.0)
    return layer, qx, qy, falling


def spreading_length(scene: Scene, body: Body) -> float:
    """Return L0 of a body: its least edge over the number of its sides that are free along this axis [m].

    A side at a wall of the box is not free. Infinite where none is.
    """
    least = math.inf
    for axis in range(scene.dim - 1):
        free = (body.position[axis] > scene.lower[axis] + GAP) + (body.upper[axis] < scene.upper[axis] - GAP)
        if free:
            least = min(least, body.size[axis] / free)
    return least


def plane_height(plane: Plane, x: Floats, y: Floats) -> Floats:
    """Return the height of a plane's surface at places [C] [m]."""
    *across, up = plane.normal
    rise = np.full(len(x), plane.point[-1])
    for axis, (part, place) in enumerate(zip(across, (x, y), strict=False)):
        rise -= part / up * (place - plane.point[axis])
    return rise


def _gap(scene: Scene, body: Body) -> float:
    """Return how far a body starts above what is under it, where it is nearest to it [m]."""
    if isinstance(body, Release):
        return 0.0
    bottom = body.position[-1]
    support = scene.lower[-1]
    corners = body.corners()[:, : scene.dim - 1]
    x, y = corners[:, 0], corners[:, 1] if scene.dim == 3 else np.zeros(len(corners))
    for obstacle in scene.obstacles:
        if isinstance(obstacle, Plane):
            support = max(support, float(plane_height(obstacle, x, y).max()))
        elif _over(body, obstacle.position, obstacle.upper):
            support = max(support, obstacle.upper[-1])
    if scene.terrain is not None:
        shares = np.indices((33,) * (scene.dim - 1)).reshape(scene.dim - 1, -1).T / 32
        places = np.array(body.position[:-1]) + shares * body.size[:-1]
        support = max(support, float(scene.terrain.height(places).max()))
    for other in scene.bodies:
        if other is not body and other.upper[-1] <= bottom + GAP and _over(body, other.position, other.upper):
            support = max(support, other.upper[-1])
    return bottom - support


def _over(body: Body, lower: Sequence[float], upper: Sequence[float]) -> bool:
    """Tell whether a body stands over, or in, a cuboid."""
    across = zip(body.position[:-1], body.upper[:-1], lower[:-1], upper[:-1], strict=True)
    return all(low < high and other_low < end for low, end, other_low, high in across)
