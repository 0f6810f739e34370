"""The grid between the two transfers, and the loop over steps that joins all three."""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

from gns_pl.mpm.compiled import compiled
from gns_pl.mpm.transfer import grid_to_points, points_to_grid
from gns_pl.mpm.walls import clearance, hold_at_walls


@compiled
def active_range(position, cells, nodes):
    """Return first and last-plus-one node per axis that points can reach (x0, x1, y0, y1, z0, z1)."""
    x0 = y0 = z0 = math.inf
    x1 = y1 = z1 = 0.0
    for p in range(position.shape[0]):
        x0, x1 = min(x0, position[p, 0]), max(x1, position[p, 0])
        y0, y1 = min(y0, position[p, 1]), max(y1, position[p, 1])
        z0, z1 = min(z0, position[p, 2]), max(z1, position[p, 2])
    return (
        max(int(x0) - 1, 0), min(int(x1) + 3, nodes[0]),
        max(int(y0) - 1, 0), min(int(y1) + 3, nodes[1]),
        max(int(z0) - 1, 0), min(int(z1) + 3, nodes[2]),
    )  # fmt: skip


@compiled
def clear_nodes(grid, gap, active, nodes):
    """Set the active nodes to zero mass, momentum and impulse and to no point near."""
    x0, x1, y0, y1, z0, z1 = active
    for i in range(x0, x1):
        for j in range(y0, y1):
            first = (i * nodes[1] + j) * nodes[2]
            grid[first + z0 : first + z1] = 0.0
            gap[first + z0 : first + z1] = math.inf


@compiled
def move_nodes(grid, gap, active, cells, nodes, inverse_cell, gravity, friction, radius, dt):
    """Turn momentum and impulse into velocity and its change, with gravity and walls.

    Args:
        grid, gap: see `transfer`.
        active: from `active_range`.
        cells, nodes, inverse_cell: see `transfer.points_to_grid`.
        gravity: (x, y, z) [m/s²].
        friction: [3, 2] coefficient of the lower and upper face of each axis, or `walls.STICK`.
        radius: (x, y, z) half the spacing of the points [cells].
        dt: time step [s].
    """
    ny, nz = nodes[1], nodes[2]
    x0, x1, y0, y1, z0, z1 = active
    plane = cells[1] == 0
    for i in range(x0, x1):
        sx = -1.0 if i == 0 else (1.0 if i == cells[0] else 0.0)
        for j in range(y0, y1):
            sy = 0.0 if plane else (-1.0 if j == 0 else (1.0 if j == cells[1] else 0.0))
            for k in range(z0, z1):
                node = (i * ny + j) * nz + k
                m = grid[node, 3]
                if m == 0.0:
                    continue
                one = 1.0 / m
                ox, oy, oz = grid[node, 0] * one, grid[node, 1] * one, grid[node, 2] * one
                vx = ox + grid[node, 4] * one + dt * gravity[0]
                vy = oy + grid[node, 5] * one + dt * gravity[1]
                vz = oz + grid[node, 6] * one + dt * gravity[2]
                sz = -1.0 if k == 0 else (1.0 if k == cells[2] else 0.0)
                if sx != 0.0 or sy != 0.0 or sz != 0.0:
                    mx = friction[0, 1 if sx > 0.0 else 0]
                    my = friction[1, 1 if sy > 0.0 else 0]
                    mz = friction[2, 1 if sz > 0.0 else 0]
                    vx, vy, vz = hold_at_walls(
                        vx, vy, vz,
                        clearance(gap[node, 0], radius[0], mx) / (dt * inverse_cell[0]),
                        clearance(gap[node, 1], radius[1], my) / (dt * inverse_cell[1]),
                        clearance(gap[node, 2], radius[2], mz) / (dt * inverse_cell[2]),
                        sx, sy, sz, mx, my, mz,
                    )  # fmt: skip
                grid[node, 0], grid[node, 1], grid[node, 2] = vx, vy, vz
                grid[node, 4], grid[node, 5], grid[node, 6] = vx - ox, vy - oy, vz - oz


@compiled
def advance(
    position, velocity, affine, stress, mass, volume, material_index, materials, grid, gap,
    cells, nodes, inverse_cell, gravity, friction, radius, layers, affine_fraction, flip_fraction, dt, num_steps,
):  # fmt: skip
    """Make `num_steps` explicit steps in place; arguments as in the functions called.

    Returns:
        Number of coordinates that had to be put back inside the box.
    """
    put_back = 0
    for _ in range(num_steps):
        active = active_range(position, cells, nodes)
        clear_nodes(grid, gap, active, nodes)
        points_to_grid(
            position, velocity, affine, stress, mass, volume, material_index, materials,
            grid, gap, cells, nodes, inverse_cell, layers, affine_fraction, dt,
        )  # fmt: skip
        move_nodes(grid, gap, active, cells, nodes, inverse_cell, gravity, friction, radius, dt)
        put_back += grid_to_points(
            position, velocity, affine, stress, material_index, materials,
            grid, cells, nodes, inverse_cell, layers, flip_fraction, dt,
        )  # fmt: skip
    return put_back
