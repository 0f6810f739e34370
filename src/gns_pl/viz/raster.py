"""Grains as shaded discs in a pixel image: fast enough for animations, and the same look in every figure.

Pure NumPy. The side view looks along the second axis from its lower end, as through a glass wall, and grains nearer to
that wall hide those behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gns_pl.scene import Box, Plane, Scene
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap

LIGHT = np.array([-0.4, 0.6, 0.7]) / np.linalg.norm([-0.4, 0.6, 0.7])
"""Direction to the light: right, up, towards the eye."""

AMBIENT = 0.45
"""Brightness of a grain's part that the light does not reach."""


@dataclass(frozen=True)
class View:
    """A window on the x–z plane.

    Attributes:
        lower: x and z of its lower left corner [m].
        upper: x and z of its upper right corner [m].
        resolution: pixels per metre.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    resolution: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        width, height = (u - w for u, w in zip(self.upper, self.lower, strict=True))
        return max(1, round(height * self.resolution)), max(1, round(width * self.resolution))


def side_window(trajectories: Sequence[Trajectory], diameter: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the lower and upper corner of a window that shows the box as far up as any grain or block ever is [m].

    Args:
        trajectories: of one scene, finite.
        diameter: of a grain [m]; left free above the highest one.
    """
    scene = trajectories[0].scene
    top = max(float(trajectory.position[:, :, -1].max()) for trajectory in trajectories) + 1.5 * diameter
    blocks = [obstacle.upper[-1] + diameter for obstacle in scene.obstacles if isinstance(obstacle, Box)]
    blocks += [float(scene.terrain.heights.max())] if scene.terrain is not None else []
    top = max(top, *blocks) if blocks else top
    top = min(max(top, scene.lower[-1] + 2 * diameter), scene.upper[-1])
    return (scene.lower[0], scene.lower[-1]), (scene.upper[0], top)


def obstacle_outlines(
    scene: Scene, lower: tuple[float, float], upper: tuple[float, float]
) -> list[NDArray[np.float64]]:
    """Return the obstacles as seen from the side, cut to a window: corners [M, 2] [m] of a polygon each.

    Args:
        scene: in two or three dimensions; a plane that is inclined across the view, and a terrain, are cut in the
            middle of the box.
        lower: x and z of the window's lower left corner [m].
        upper: x and z of its upper right corner [m].
    """
    window = np.array([lower, (lower[0], upper[1]), upper, (upper[0], lower[1])], dtype=np.float64)
    outlines = [] if scene.terrain is None else [_profile(scene, lower, upper)]
    for obstacle in scene.obstacles:
        if isinstance(obstacle, Plane):
            middle = (np.array(scene.lower) + scene.upper) / 2
            places = np.tile(middle, (4, 1))
            places[:, [0, -1]] = window
            height = (places - obstacle.point) @ np.array(obstacle.normal)
            outline = _behind(window, height)
        else:
            low, high = (np.array([corner[0], corner[-1]]) for corner in (obstacle.position, obstacle.upper))
            (x0, z0), (x1, z1) = np.maximum(low, lower), np.minimum(high, upper)
            outline = np.array([[x0, z0], [x0, z1], [x1, z1], [x1, z0]] if x0 < x1 and z0 < z1 else []).reshape(-1, 2)
        if len(outline) > 2:
            outlines.append(outline)
    return outlines


def _profile(scene: Scene, lower: tuple[float, float], upper: tuple[float, float]) -> NDArray[np.float64]:
    """Return the ground in a vertical plane along x through the middle of the box [M, 2] [m]."""
    assert scene.terrain is not None
    places = np.tile((np.array(scene.lower) + scene.upper) / 2, (400, 1))
    places[:, 0] = np.linspace(lower[0], upper[0], len(places))
    surface = np.clip(scene.terrain.height(places[:, :-1]), lower[1], upper[1])
    line = np.column_stack([places[:, 0], surface])
    return np.concatenate([line, [[upper[0], lower[1]], [lower[0], lower[1]]]])


def _behind(corners: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of a convex polygon [M, 2] whose corners' heights over a line [M] are not positive."""
    polygon = []
    for number, corner in enumerate(corners):
        before = number - 1
        if (height[before] < 0) != (height[number] < 0):
            share = height[before] / (height[before] - height[number])
            polygon.append(corners[before] + share * (corner - corners[before]))
        if height[number] < 0:
            polygon.append(corner)
    return np.array(polygon).reshape(-1, 2)


def draw_grains(
    position: NDArray[np.floating], value: NDArray[np.floating], view: View, diameter: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw every particle as a lit disc.

    Args:
        position: [N, D] [m].
        value: [N], what the colour means.
        view: the window; row 0 of the images is its upper edge.
        diameter: of a grain [m].

    Returns:
        The values and the brightness (0 to 1) of the grains in front, both [rows, columns]; NaN where there is none.
    """
    rows, columns = view.shape
    radius = max(0.5 * diameter * view.resolution, 0.5)
    reach = int(np.ceil(radius))
    right, down = (grid.ravel() for grid in np.meshgrid(*[np.arange(-reach, reach + 1)] * 2))
    inside = right**2 + down**2 <= radius**2
    right, down = right[inside], down[inside]
    normal = np.stack([right, -down]) / radius
    facing = np.sqrt(np.maximum(0, 1 - (normal**2).sum(axis=0)))
    light = LIGHT[0] * normal[0] + LIGHT[1] * normal[1] + LIGHT[2] * facing
    brightness = (AMBIENT + (1 - AMBIENT) * np.maximum(light, 0)).astype(np.float32)
    far_first = np.argsort(-position[:, 1], kind="stable") if position.shape[1] == 3 else np.arange(len(position))
    x, z = position[far_first, 0], position[far_first, -1]
    column = np.floor((x - view.lower[0]) * view.resolution)[:, None] + right
    row = np.floor((view.upper[1] - z) * view.resolution)[:, None] + down
    seen = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    pixel = (row[seen] * columns + column[seen]).astype(np.int64)
    values = np.full(rows * columns, np.nan, dtype=np.float32)
    shades = np.full(rows * columns, np.nan, dtype=np.float32)
    # of equal indices NumPy keeps the last assignment, which is the nearest grain
    values[pixel] = np.broadcast_to(value[far_first, None], seen.shape)[seen]
    shades[pixel] = np.broadcast_to(brightness, seen.shape)[seen]
    return values.reshape(rows, columns), shades.reshape(rows, columns)


def displacement(trajectory: Trajectory, frame: int) -> NDArray[np.float64]:
    """Return how far every particle is from where it started [N] [m]."""
    moved = trajectory.position[frame].astype(np.float64) - trajectory.position[0]
    return np.asarray(np.linalg.norm(moved, axis=1))


def displacement_limit(trajectory: Trajectory) -> float:
    """Return the upper end of the colour scale: what 99 % of the particles do not exceed in the last frame [m]."""
    return max(float(np.percentile(displacement(trajectory, -1), 99)), 1e-6)


def colour_map() -> ListedColormap:
    """Return viridis without its darkest part, in which shaded grains could not be told apart."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis"](np.linspace(0.12, 1, 256)), name="grains")
