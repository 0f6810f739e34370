"""The ground under a run: a scene's terrain on the columns of the grid, its distance and normal for the kernels.

The terrain becomes its mean heights over cells around the columns of nodes, one column beyond the box on every side,
and between them a quadratic B-spline, whose slope has no jumps: a plane stays that plane, and what is finer than a cell
is smoothed. It is one more row of the table of obstacles (`obstacles`), which goes on with the heights:

======  =========================================================
0       `GROUND`
1, 2    one over a cell's edge along x and y; 0 along y in the plane [1/m]
4, 5    number of columns along x and y; 1 along y in the plane
7       friction
8 …     heights over the lower face of the box, y running fastest [m]
======  =========================================================

Scenes with a terrain run in variants of the kernels (`compiled.variant`) in which `signed_distance` is
`surface_distance`; all others run the code that they always ran.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gns_pl.mpm.compiled import compiled
from gns_pl.mpm.obstacles import obstacle_table
from gns_pl.mpm.obstacles import signed_distance as solid_distance
from gns_pl.mpm.walls import wall_number
from gns_pl.scene import Particles, Scene
from gns_pl.scene.terrain import Terrain, check_resolved

if TYPE_CHECKING:
    from gns_pl.mpm.plan import Grid

GROUND = 2.0
HEIGHTS = 8
"""Where the heights begin in the row."""

REFINED = 1.0
"""Up to so many cells from the surface its distance is refined at the foot of the perpendicular."""

STEEPEST_DEG = 75.0
"""Steepest ground between two columns of nodes that is run."""

ROUGHEST = 2.0
"""Largest change of the slope from one cell to the next that is run."""


def surface_table(scene: Scene, grid: Grid) -> NDArray[np.float64]:
    """Return the obstacles and the ground of a scene as rows, see above; [O, 8] where there is no terrain.

    Args:
        scene: with its obstacles and its terrain.
        grid: of the run.
    """
    table = obstacle_table(scene, grid.lower, grid.axes)
    if scene.terrain is None:
        return table
    heights = column_heights(scene.terrain, grid)
    row = np.zeros(HEIGHTS + heights.size)
    row[0] = GROUND
    for number, (axis, count) in enumerate(zip(grid.axes[:-1], heights.shape, strict=True)):
        row[1 + number], row[4 + number] = 1.0 / grid.cell[axis], count
    if scene.dim == 2:
        row[5] = 1.0
    row[7] = wall_number(scene.terrain.wall)
    row[HEIGHTS:] = heights.ravel() - grid.lower[2]
    return np.concatenate([np.pad(table, ((0, 0), (0, heights.size))), row[None]])


def column_heights(terrain: Terrain, grid: Grid) -> NDArray[np.float64]:
    """Return the mean heights around the columns of nodes and one beyond on every side [NX + 3, NY + 3] [m]."""
    edges = [
        np.array(grid.lower[axis] + grid.cell[axis] * (np.arange(grid.nodes[axis] + 3) - 1.5))
        for axis in grid.axes[:-1]
    ]
    return terrain.means(edges)


def check_ground(scene: Scene, grid: Grid) -> None:
    """Raise an `InputError` where the ground is steeper or rougher than the cells of a grid resolve."""
    if scene.terrain is None:
        return
    heights = column_heights(scene.terrain, grid)
    axes = grid.axes[:-1]
    check_resolved(
        f"mpm: scene {scene.name!r}",
        heights[(slice(1, -1),) * heights.ndim],
        lower=[grid.lower[axis] for axis in axes],
        cells=[grid.cell[axis] for axis in axes],
        steepest_deg=STEEPEST_DEG,
        roughest=ROUGHEST,
    )


def on_ground(scene: Scene, particles: Particles, grid: Grid) -> Particles:
    """Return points moved up or down by as much as the ground on the grid is above the terrain at their places."""
    if scene.terrain is None:
        return particles
    row = surface_table(scene, grid)[-1]
    position = particles.position.copy()
    places = np.zeros((len(position), 2))
    places[:, : scene.dim - 1] = position[:, :-1] - np.array(grid.lower)[list(grid.axes[:-1])]
    height = np.empty(len(position))
    fill_heights(row, places, height)
    position[:, -1] += height + grid.lower[2] - scene.terrain.height(position)
    return replace(particles, position=position)


@compiled
def fill_heights(ground, places, height):
    """Write the height of the surface [N] at places [N, 2] over the lower corner of the box [m]."""
    for p in range(len(places)):
        height[p] = surface(ground, places[p, 0], places[p, 1])[0]


@compiled
def spline(place, count):
    """Return the quadratic B-splines of an axis at a place, extended as straight lines beyond the columns.

    Args:
        place: in cells from the first column.
        count: number of columns.

    Returns:
        First of the three columns, weights, slopes of the weights [1/cell], how far the place lies beyond [cells].
    """
    base = min(int(max(place - 0.5, 0.0)), count - 3)
    along = place - base - 1.0
    inside = min(max(along, -0.5), 0.5)
    low, high = 0.5 - inside, 0.5 + inside
    return base, 0.5 * low * low, 0.75 - inside * inside, 0.5 * high * high, -low, -2.0 * inside, high, along - inside


@compiled
def surface(ground, x, y):
    """Return the height of the ground over the lower face of the box [m] and its slopes along x and y.

    Args:
        ground: row of the table, see above.
        x, y: place [m].
    """
    along_y = int(ground[5])
    bx, x0, x1, x2, gx0, gx1, gx2, far_x = spline(x * ground[1] + 1.0, int(ground[4]))
    if along_y == 1:
        node = HEIGHTS + bx
        low, middle, high = ground[node], ground[node + 1], ground[node + 2]
        rise = gx0 * low + gx1 * middle + gx2 * high
        return x0 * low + x1 * middle + x2 * high + far_x * rise, rise * ground[1], 0.0 * rise
    by, y0, y1, y2, gy0, gy1, gy2, far_y = spline(y * ground[2] + 1.0, along_y)
    node = HEIGHTS + bx * along_y + by
    a, b, c = ground[node], ground[node + 1], ground[node + 2]
    low, low_rise = y0 * a + y1 * b + y2 * c, gy0 * a + gy1 * b + gy2 * c
    node += along_y
    a, b, c = ground[node], ground[node + 1], ground[node + 2]
    middle, middle_rise = y0 * a + y1 * b + y2 * c, gy0 * a + gy1 * b + gy2 * c
    node += along_y
    a, b, c = ground[node], ground[node + 1], ground[node + 2]
    high, high_rise = y0 * a + y1 * b + y2 * c, gy0 * a + gy1 * b + gy2 * c
    rise_x = gx0 * low + gx1 * middle + gx2 * high
    rise_y = x0 * low_rise + x1 * middle_rise + x2 * high_rise
    height = x0 * low + x1 * middle + x2 * high
    return height + far_x * rise_x + far_y * rise_y, rise_x * ground[1], rise_y * ground[2]


@compiled
def surface_distance(obstacle, x, y, z):
    """Return what `obstacles.signed_distance` does, of the ground too.

    (z − h) n_z, the distance from the tangent plane below a point; near the surface that from the tangent plane at the
    foot of this perpendicular, one step of Newton's method.
    """
    if obstacle[0] != GROUND:
        return solid_distance(obstacle, x, y, z)
    height, sx, sy = surface(obstacle, x, y)
    up = 1.0 / math.sqrt(1.0 + sx * sx + sy * sy)
    distance = (z - height) * up
    if abs(distance) * obstacle[1] < REFINED:
        ax, ay = distance * sx * up, distance * sy * up  # from the point to the foot
        height, sx, sy = surface(obstacle, x + ax, y + ay)
        up = 1.0 / math.sqrt(1.0 + sx * sx + sy * sy)
        distance = (z - height + ax * sx + ay * sy) * up
    return distance, -sx * up, -sy * up, up


GROUND_NAMES = {"signed_distance": surface_distance}
"""What names mean in the kernels of scenes with a terrain (`compiled.variant`)."""
