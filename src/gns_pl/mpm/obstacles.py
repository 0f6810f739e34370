"""Obstacles inside the box, sloping planes and upright cuboids: distance, contact of nodes, approach of points.

A wall of the box lies on grid nodes and holds them alone. An obstacle does not, so it holds every node inside it, and
just outside (`OBSTACLE_BAND`), that material reaches: such a node may not move further in than the nearest point of
material is away (less its radius), and slides along with Coulomb friction, by the same rules as at a wall. Points are
slowed on their last way to the surface so that none goes through.

An obstacle is a row of numbers: kind, a (3), b (3), friction. A plane has a point a and its normal b into the open; a
cuboid its lower corner a and upper corner b. Lengths in metres from the lower corner of the box. In the plane, y = 0
and cuboids reach through.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gns_pl.mpm.compiled import compiled
from gns_pl.mpm.walls import STICK, clearance, normal_velocity, slip_factor, wall_number
from gns_pl.scene import Plane, Scene

PLANE, CUBOID = 0.0, 1.0
OBSTACLE_BAND = 0.7
"""Nodes up to this far outside an obstacle are held as well [cells]. With the inner nodes alone material is squeezed as
if the surface lay up to a cell deeper, and a deposit loses up to a third of its height; with whole cells it gains as
much. In between, volume is right to some 10 % of a cell's layer wherever the surface cuts the grid."""
FAR = 1e6
"""Half the width of a plane scene's cuboids along y [m]."""


def obstacle_table(scene: Scene, lower: tuple[float, ...], axes: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the obstacles of a scene as rows [O, 8], see above.

    Args:
        scene: with its obstacles.
        lower: lower corner of the box, three entries [m].
        axes: of the scene among x, y, z.
    """
    table = np.zeros((len(scene.obstacles), 8))
    for row, obstacle in zip(table, scene.obstacles, strict=True):
        first, second = np.zeros(3), np.zeros(3)
        if isinstance(obstacle, Plane):
            row[0] = PLANE
            first[list(axes)] = np.array(obstacle.point) - np.array(lower)[list(axes)]
            second[list(axes)] = obstacle.normal
        else:
            row[0] = CUBOID
            first[:], second[:] = -FAR, FAR
            first[list(axes)] = np.array(obstacle.position) - np.array(lower)[list(axes)]
            second[list(axes)] = first[list(axes)] + obstacle.size
        row[1:4], row[4:7] = first, second
        row[7] = wall_number(obstacle.wall)
    return table


@compiled
def signed_distance(obstacle, x, y, z):
    """Return the distance from an obstacle's surface, negative inside it [m], and the unit normal into the open.

    Args:
        obstacle: [8] row of the table.
        x, y, z: place [m].
    """
    if obstacle[0] == PLANE:
        nx, ny, nz = obstacle[4], obstacle[5], obstacle[6]
        return (x - obstacle[1]) * nx + (y - obstacle[2]) * ny + (z - obstacle[3]) * nz, nx, ny, nz
    # Distance beyond the nearer face of each axis, and the side that face is on.
    sx, dx = beyond(x, obstacle[1], obstacle[4])
    sy, dy = beyond(y, obstacle[2], obstacle[5])
    sz, dz = beyond(z, obstacle[3], obstacle[6])
    if dx <= 0.0 and dy <= 0.0 and dz <= 0.0:
        if dx >= dy and dx >= dz:
            return dx, sx, 0.0, 0.0
        if dy >= dz:
            return dy, 0.0, sy, 0.0
        return dz, 0.0, 0.0, sz
    ox, oy, oz = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
    distance = math.sqrt(ox * ox + oy * oy + oz * oz)
    return distance, sx * ox / distance, sy * oy / distance, sz * oz / distance


@compiled
def beyond(x, low, high):
    """Return the side of the nearer face, −1 or +1, and how far x lies beyond it, negative between the faces [m]."""
    if low - x > x - high:
        return -1.0, low - x
    return 1.0, x - high


@compiled
def hold_at_obstacle(obstacle, x, y, z, gap, radius, band, dt, vx, vy, vz):
    """Return the velocity of a node after an obstacle [m/s], unchanged away from it.

    Args:
        obstacle: [8] row of the table.
        x, y, z: the node's place [m].
        gap: smallest distance from the obstacle of a point that reaches the node [m].
        radius: half the spacing of the points [m].
        band: distance from the surface up to which nodes are held [m].
        dt: time step [s].
        vx, vy, vz: velocity before [m/s].
    """
    distance, nx, ny, nz = signed_distance(obstacle, x, y, z)
    if distance > band:
        return vx, vy, vz
    friction = obstacle[7]
    inward = -(vx * nx + vy * ny + vz * nz)
    limit = clearance(max(gap, 0.0), radius, friction) / dt
    new = normal_velocity(inward, limit, friction)
    tx, ty, tz = vx + inward * nx, vy + inward * ny, vz + inward * nz
    if new != inward or (limit <= 0.0 and friction == STICK):
        factor = slip_factor(abs(inward - new), math.sqrt(tx * tx + ty * ty + tz * tz), friction)
        tx, ty, tz = factor * tx, factor * ty, factor * tz
    return tx - new * nx, ty - new * ny, tz - new * nz


@compiled
def approach_obstacle(obstacle, x, y, z, ux, uy, uz, reach):
    """Return the displacement of a point, slowed on its last way to an obstacle as `shape.approach_wall` does [m].

    Args:
        obstacle: [8] row of the table.
        x, y, z: the point's place before [m].
        ux, uy, uz: displacement that the grid gives [m].
        reach: distance from which on it is slowed [m].
    """
    distance, nx, ny, nz = signed_distance(obstacle, x, y, z)
    inward = -(ux * nx + uy * ny + uz * nz)
    if inward <= 0.0 or distance >= reach:
        return ux, uy, uz
    kept = max(distance, 0.0) / reach
    lost = inward * (1.0 - kept)
    return ux + lost * nx, uy + lost * ny, uz + lost * nz
