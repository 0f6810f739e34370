"""What a three-dimensional picture shows, and from where: window, camera, obstacles, colours. NumPy and SciPy only.

A two-dimensional trajectory is shown as a slice one grain thick, in the plane y = 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.scene import Plane, Scene, Terrain
from gns_pl.scene.extent import characteristic_time
from gns_pl.trajectory import Trajectory
from gns_pl.viz.raster import colour_map, displacement

Floats = NDArray[np.float64]

COLOURINGS = {"displacement": "displacement [m]", "speed": "speed [m/s]"}
"""What colours can mean, and what a colour bar says of it."""

KINEMATIC_GREY = (140, 140, 140)
"""Colour of particles that move by a script, and of particles whose value is not finite."""

TOWARDS_EYE = {2: (0.0, -1.0, 0.0), 3: (0.28, -1.0, 0.42)}
"""Direction from the scene to the eye, by dimension: flows that run along x come nearer."""

EYE_DISTANCE = 5.0
"""Distance of the eye from the middle of the window, in diagonals of the window: a weak perspective."""

MOST_LINES = 200
"""Lines of the net that shows a terrain, along each axis."""

SAMPLED_FRAMES = 30
"""The colour scale is that of about so many frames."""


@dataclass(frozen=True)
class Window:
    """The part of the box that is shown.

    Attributes:
        lower: corner of the box [3] [m].
        upper: of the box in x and y, in z somewhat above the highest grain and never above the box [3] [m].
        sides: lengths worth a label, by axis.
    """

    lower: Floats
    upper: Floats
    sides: str

    def corners(self) -> Floats:
        """Return its corners [8, 3] [m]; bit 2 of a corner's number says upper x, bit 1 upper y, bit 0 upper z."""
        choice = np.array([[number >> 2 & 1, number >> 1 & 1, number & 1] for number in range(8)])
        return np.where(choice == 1, self.upper, self.lower)

    def edges(self) -> list[tuple[int, int]]:
        """Return the pairs of corners that an edge joins [12]."""
        return [(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]


@dataclass(frozen=True)
class Camera:
    """An eye that sees a window whole and nothing more.

    Attributes:
        eye: where it is [3] [m].
        right: unit vector to the right of the picture [3].
        up: unit vector upwards in the picture [3].
        half_width: half of the picture's width at distance 1.
        half_height: half of the picture's height at distance 1.
    """

    eye: Floats
    right: Floats
    up: Floats
    half_width: float
    half_height: float

    @property
    def forward(self) -> Floats:
        """Unit vector into the picture [3]."""
        return np.cross(self.up, self.right)

    @property
    def view_angle_deg(self) -> float:
        """Angle between the rays to the picture's lower and upper edge."""
        return 2 * math.degrees(math.atan(self.half_height))

    @property
    def ratio(self) -> float:
        """Width over height of the picture."""
        return self.half_width / self.half_height

    def project(self, points: Floats) -> Floats:
        """Return where points [M, 3] [m] are in the picture [M, 2], from (0, 0) lower left to (1, 1) upper right."""
        from_eye = points - self.eye
        plane = from_eye @ np.stack([self.right / self.half_width, self.up / self.half_height], axis=1)
        return np.asarray(0.5 + 0.5 * plane / (from_eye @ self.forward)[:, None])


def in_space(vectors: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return vectors [N, D] in three dimensions [N, 3], y = 0 where there were two."""
    space = np.zeros((len(vectors), 3), dtype=np.float32)
    space[:, [0, 2] if vectors.shape[1] == 2 else [0, 1, 2]] = vectors
    return space


def grain_diameters(trajectory: Trajectory) -> Floats:
    """Return the edge of the cube (or square) that every particle stands for [N] [m].

    Where a particle's density is open or its volume nothing, it is that of the mean particle.
    """
    scene = trajectory.scene
    bodies = sum(body.volume for body in scene.bodies)
    mean = bodies / max(int((trajectory.particle_type != ParticleType.KINEMATIC).sum()), 1)
    try:
        volume = trajectory.volume().astype(np.float64)
    except InputError:
        volume = np.full(trajectory.num_particles, mean)
    return np.asarray(np.where(volume > 0, volume, mean) ** (1 / scene.dim))


def window_of(trajectories: Sequence[Trajectory]) -> Window:
    """Return the window that shows all of these trajectories.

    Raises:
        InputError: no trajectories, or of different boxes.
    """
    if not trajectories:
        raise InputError("picture: there is no trajectory to show.")
    scene = trajectories[-1].scene
    for trajectory in trajectories:
        if (trajectory.scene.lower, trajectory.scene.upper) != (scene.lower, scene.upper):
            raise InputError(
                f"picture: scenes {trajectory.scene.name!r} and {scene.name!r} have different boxes; show them apart."
            )
    diameter = max(float(grain_diameters(trajectory).max()) for trajectory in trajectories)
    heights = [trajectory.position[..., -1] for trajectory in trajectories]
    tops = [float(height[np.isfinite(height)].max(initial=scene.lower[-1])) for height in heights]
    tops += [obstacle.upper[-1] for obstacle in scene.obstacles if not isinstance(obstacle, Plane)]
    tops += [float(scene.terrain.heights.max())] if scene.terrain is not None else []
    height = max(tops) + diameter - scene.lower[-1]
    step = 10 ** math.floor(math.log10(height)) / 2
    top = min(scene.upper[-1], scene.lower[-1] + math.ceil(height / step) * step)
    if scene.dim == 2:
        thickness = 0.5 * diameter
        return Window(
            np.array([scene.lower[0], -thickness, scene.lower[1]]), np.array([scene.upper[0], thickness, top]), "xz"
        )
    return Window(np.array(scene.lower), np.array([*scene.upper[:2], top]), "xyz")


def camera_of(window: Window, dim: int, margin: float = 0.03) -> Camera:
    """Return the camera that looks at a window of a scene of `dim` dimensions, with a margin around it [half sizes]."""
    towards = np.array(TOWARDS_EYE[dim]) / np.linalg.norm(TOWARDS_EYE[dim])
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    corners = window.corners()
    distance = EYE_DISTANCE * float(np.linalg.norm(window.upper - window.lower))
    eye = 0.5 * (window.lower + window.upper) + distance * towards
    camera = Camera(eye, right, up, 1.0, 1.0)
    for _ in range(20):  # moving the eye sideways changes the perspective, so that it takes a few rounds
        seen = 2 * camera.project(corners) - 1
        middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        camera = Camera(camera.eye + distance * (middle[0] * right + middle[1] * up), right, up, 1.0, 1.0)
    half = np.abs(2 * camera.project(corners) - 1).max(axis=0)
    half += margin * half.max()
    return Camera(camera.eye, right, up, float(half[0]), float(half[1]))


def obstacle_solids(scene: Scene, window: Window) -> list[tuple[Floats, NDArray[np.int64]]]:
    """Return ground and obstacles (convex), cut to the window, as points [M, 3] [m] and triangles [F, 3]."""
    from scipy.spatial import ConvexHull

    solids = [] if scene.terrain is None else [_ground(scene.terrain, window)]
    for obstacle in scene.obstacles:
        if isinstance(obstacle, Plane):
            points = _behind(window, in_space(np.array([obstacle.point]))[0], in_space(np.array([obstacle.normal]))[0])
        else:
            lower, upper = (in_space(np.array([corner]))[0] for corner in (obstacle.position, obstacle.upper))
            if scene.dim == 2:
                lower[1], upper[1] = window.lower[1], window.upper[1]
            lower, upper = np.maximum(lower, window.lower), np.minimum(upper, window.upper)
            points = Window(lower, upper, "").corners()
        if len(points) < 4 or np.linalg.matrix_rank(points - points[0], tol=1e-9) < 3:
            continue  # the window has nothing of it
        solids.append((points, np.asarray(ConvexHull(points).simplices, dtype=np.int64)))
    return solids


def _ground(terrain: Terrain, window: Window) -> tuple[Floats, NDArray[np.int64]]:
    """Return the surface of a terrain in a window, as points [M, 3] [m] and triangles [F, 3]."""
    counts = [min(MOST_LINES, number + 1) for number in (*terrain.heights.shape, 1)[:2]]
    lines = [np.linspace(window.lower[axis], window.upper[axis], number) for axis, number in enumerate(counts)]
    x, y = (each.ravel() for each in np.meshgrid(*lines, indexing="ij"))
    height = terrain.height(np.column_stack([x, y])[:, : terrain.heights.ndim])
    points = np.column_stack([x, y, np.clip(height, window.lower[2], window.upper[2])])
    number = np.arange(len(points)).reshape(counts)
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _behind(window: Window, point: Floats, normal: Floats) -> Floats:
    """Return the corners of the part of a window that lies behind a plane [M, 3] [m]."""
    corners = window.corners()
    height = (corners - point) @ normal
    polygon = list(corners[height <= 0])
    for a, b in window.edges():
        if (height[a] < 0) != (height[b] < 0):
            polygon.append(corners[a] + height[a] / (height[a] - height[b]) * (corners[b] - corners[a]))
    return np.array(polygon).reshape(-1, 3)


def values_of(trajectory: Trajectory, frame: int, colour: str) -> Floats:
    """Return what colours mean, one of `COLOURINGS`, for the particles of a frame [N].

    Raises:
        InputError: an unknown colouring.
    """
    if colour not in COLOURINGS:
        raise InputError(f"picture: colour must be one of {', '.join(COLOURINGS)}, not {colour!r}.")
    if colour == "displacement":
        return displacement(trajectory, frame)
    if frame == 0:
        return np.asarray(np.linalg.norm(trajectory.initial_velocity.astype(np.float64), axis=1))
    moved = trajectory.position[frame].astype(np.float64) - trajectory.position[frame - 1]
    return np.asarray(np.linalg.norm(moved, axis=1) / trajectory.dt)


def limit_of(trajectory: Trajectory, colour: str) -> float:
    """Return the upper end of the colour scale: what 99 % of the grains never exceed, looked at in some frames."""
    grains = trajectory.particle_type != ParticleType.KINEMATIC
    limit = 1e-6
    for frame in evenly(trajectory.num_frames, SAMPLED_FRAMES):
        values = values_of(trajectory, frame, colour)[grains]
        values = values[np.isfinite(values)]
        if len(values):
            limit = max(limit, float(np.percentile(values, 99)))
    return limit


def colours_of(trajectory: Trajectory, frame: int, colour: str, limit: float) -> NDArray[np.uint8]:
    """Return the colours of the particles of a frame [N, 3]."""
    values = values_of(trajectory, frame, colour)
    colours = np.asarray(255 * np.asarray(colour_map()(np.nan_to_num(values / limit)))[:, :3]).round().astype(np.uint8)
    colours[(trajectory.particle_type == ParticleType.KINEMATIC) | ~np.isfinite(values)] = KINEMATIC_GREY
    return colours


def evenly(number: int, at_most: int) -> list[int]:
    """Return at most so many of `number` indices, evenly spaced, the first and the last among them."""
    return [int(index) for index in np.unique(np.linspace(0, number - 1, min(number, at_most)).round())]


def collapse_time(scene: Scene) -> float | None:
    """Return τc = √(H0 / g) [s]; None without gravity."""
    return characteristic_time(scene) if any(scene.gravity) else None
