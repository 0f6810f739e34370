"""Points to grid and back: the two loops over all material points.

One source for two and three dimensions: every point has three coordinates, and a plane scene has a y axis of one node
layer with weight 1 and gradient 0. `layers` says which: (0, 1, 2) in space, (0,) in the plane; its length is part of
its type, so numba compiles one kernel for each and unrolls both.

Arrays, N points and M grid nodes (node (i, j, k) in row (i · ny + j) · nz + k):

===========  ========  ====================================================================================
position     [N, 3]    in cells from the lower corner of the box
velocity     [N, 3]    [m/s]
affine       [N, 9]    velocity gradient ∂v_a/∂x_b at column 3 a + b [1/s]
stress       [N, 7]    deviator xx, yy, zz, xy, yz, zx and signed pressure [Pa]
mass         [N]       [kg]
volume       [N]       at the start [m³]; the stress is taken per initial volume, its change is below 1 %
grid         [M, 8]    p2g: momentum (0–2), mass (3), impulse of the stresses (4–6);
                       after `move_nodes`: velocity (0–2), mass, change of velocity (4–6)
gap          [M, 3+O]  per axis, smallest distance of a point around a wall node from that wall [cells], then per
                       obstacle, smallest distance of a point around a node from it [m]
order        [N]       the order in which points are taken: sorted by blocks of cells (`grid.sort_points`)
===========  ========  ====================================================================================

==================================================================  ==================
equation (D, g: `shape.axis_shape`)                                 code
==================================================================  ==================
m_i = Σ_p w_ip m_p                                                  `points_to_grid`
(m v)_i = Σ_p w_ip m_p (v_p + C_p (x_i − x_p))  (APIC)              `points_to_grid`
Δ(m v)_i = −dt Σ_p V_p σ_p g_ip  (MLS-MPM)                          `points_to_grid`
v_p ← α (v_p + Σ_i w_ip Δv_i) + (1 − α) Σ_i w_ip v_i  (FLIP)        `grid_to_points`
C_p = Σ_i v_i ⊗ g_ip, x_p ← x_p + dt Σ_i w_ip v_i                   `grid_to_points`
==================================================================  ==================
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from gns_pl.mpm.compiled import compiled
from gns_pl.mpm.constitutive import total_pressure, update_stress
from gns_pl.mpm.obstacles import approach_obstacle, signed_distance
from gns_pl.mpm.row import first_half, lane, load_row, make_row, store_row
from gns_pl.mpm.shape import WALL_REACH, approach_wall, axis_shape, pick

real = np.float64

WALL_MARGIN = 1e-3
"""Points are kept this far from a wall, in cells."""

OBSTACLE_REACH = 2.6
"""Points farther than this from an obstacle [cells] see no node inside it: 1.5 √3."""


@compiled
def lower(array, row, column, value):
    """Lower one entry to `value` if it is larger; on a GPU atomic."""
    array[row, column] = min(array[row, column], value)


@compiled
def note_gaps(px, py, pz, bx, by, bz, gap, cells, nodes, inverse_cell, obstacles, layers):
    """Lower the gaps of the wall nodes, and of the nodes near obstacles, that a point reaches.

    Args:
        px, py, pz: place of the point [cells].
        bx, by, bz: first node that it reaches along each axis.
        gap, cells, nodes, inverse_cell, obstacles, layers: as in `points_to_grid`.
    """
    ny, nz = nodes[1], nodes[2]
    # A point whose stencil reaches a wall is within a cell and a half of it.
    for side in range(2):
        if bx == (cells[0] - 2 if side else 0):
            for j in range(len(layers)):
                for k in range(3):
                    node = ((cells[0] if side else 0) * ny + by + j) * nz + bz + k
                    lower(gap, node, 0, real(cells[0]) - px if side else px)
        if len(layers) == 3 and by == (cells[1] - 2 if side else 0):
            for i in range(3):
                for k in range(3):
                    node = ((bx + i) * ny + (cells[1] if side else 0)) * nz + bz + k
                    lower(gap, node, 1, real(cells[1]) - py if side else py)
        if bz == (cells[2] - 2 if side else 0):
            for i in range(3):
                for j in range(len(layers)):
                    node = ((bx + i) * ny + by + j) * nz + (cells[2] if side else 0)
                    lower(gap, node, 2, real(cells[2]) - pz if side else pz)
    if obstacles.shape[0] == 0:
        return
    ihx, ihy, ihz = inverse_cell
    reach = OBSTACLE_REACH / min(ihx, ihz) if len(layers) == 1 else OBSTACLE_REACH / min(ihx, ihy, ihz)
    for o in range(obstacles.shape[0]):
        distance = signed_distance(obstacles[o], px / ihx, py / ihy, pz / ihz)[0]
        if distance < reach:
            for i in range(3):
                for j in range(len(layers)):
                    node = ((bx + i) * ny + by + j) * nz + bz
                    for k in range(3):
                        lower(gap, node + k, 3 + o, distance)


@compiled
def point_terms(
    p, velocity, affine, stress, mass, volume, material_index, materials, inverse_cell, dx, dy, dz, affine_fraction, dt
):
    """Return what a point gives to a node: factors of its weight and of its gradient along each axis.

    Args:
        p: the point.
        dx, dy, dz: second moments of the shape functions [cell²].
        velocity, …, dt: as in `points_to_grid`.

    Returns:
        momentum (x, y, z) and mass for the weight; for each of the three gradients, momentum (x, y, z) and impulse of
        the stresses (x, y, z).
    """
    ihx, ihy, ihz = inverse_cell
    m = mass[p]
    row = materials[material_index[p]]
    force = -dt * volume[p]
    mean = total_pressure(stress[p, 6], affine[p, 0] + affine[p, 4] + affine[p, 8], row[5], row[6])
    fx, fy, fz = force * ihx, force * ihy, force * ihz
    fxx, fyy, fzz = fx * (stress[p, 0] - mean), fy * (stress[p, 1] - mean), fz * (stress[p, 2] - mean)
    fxy, fyx = fy * stress[p, 3], fx * stress[p, 3]  # f_ab: component a, gradient along b
    fyz, fzy = fz * stress[p, 4], fy * stress[p, 4]
    fzx, fxz = fx * stress[p, 5], fz * stress[p, 5]
    # w (x_i − x_p) = D g along each axis, so the affine part is a matrix times g as well.
    ax, ay, az = affine_fraction * m * dx / ihx, affine_fraction * m * dy / ihy, affine_fraction * m * dz / ihz
    return (
        (m * velocity[p, 0], m * velocity[p, 1], m * velocity[p, 2], m),
        (ax * affine[p, 0], ax * affine[p, 3], ax * affine[p, 6], fxx, fyx, fzx),
        (ay * affine[p, 1], ay * affine[p, 4], ay * affine[p, 7], fxy, fyy, fzy),
        (az * affine[p, 2], az * affine[p, 5], az * affine[p, 8], fxz, fyz, fzz),
    )


@compiled
def points_to_grid(
    first, last, order, position, velocity, affine, stress, mass, volume, material_index, materials,
    grid, gap, cells, nodes, inverse_cell, obstacles, layers, affine_fraction, dt,
):  # fmt: skip
    """Add mass, momentum and stress impulse of points to `grid` and note the nearest point of every wall node.

    Args:
        first, last: of the points `order[first:last]`.
        order: see above.
        position, velocity, affine, stress, mass, volume: points, see above.
        material_index: [N] row of `materials`.
        materials: [_, 7] from `constitutive.material_row`.
        grid, gap: nodes, see above; zero and infinite where points are.
        cells: (nx, ny, nz) cells per axis.
        nodes: (nx, ny, nz) nodes per axis.
        inverse_cell: (x, y, z) one over the cell's edges [1/m].
        obstacles: [O, 8] from `obstacles.obstacle_table`.
        layers: (0, 1, 2) or (0,), see above.
        affine_fraction: 1, or 0 for PIC, whose momentum has no affine part.
        dt: time step [s].
    """
    ny, nz = nodes[1], nodes[2]
    for place in range(first, last):
        p = order[place]
        px, py, pz = position[p, 0], position[p, 1], position[p, 2]
        bx, wx0, wx1, wx2, gx0, gx1, gx2, dx = axis_shape(px, cells[0])
        bz, wz0, wz1, wz2, gz0, gz1, gz2, dz = axis_shape(pz, cells[2])
        if len(layers) == 3:
            by, wy0, wy1, wy2, gy0, gy1, gy2, dy = axis_shape(py, cells[1])
        else:
            by, wy0, wy1, wy2, gy0, gy1, gy2, dy = 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        c, x, y, z = point_terms(
            p, velocity, affine, stress, mass, volume, material_index, materials, inverse_cell, dx, dy, dz,
            affine_fraction, dt,
        )  # fmt: skip
        none = real(0.0)
        constant = make_row(c[0], c[1], c[2], c[3], none, none, none, none)
        along_x = make_row(x[0], x[1], x[2], none, x[3], x[4], x[5], none)
        along_y = make_row(y[0], y[1], y[2], none, y[3], y[4], y[5], none)
        along_z = make_row(z[0], z[1], z[2], none, z[3], z[4], z[5], none)
        for i in range(3):
            wx, gx = pick(i, wx0, wx1, wx2), pick(i, gx0, gx1, gx2)
            for j in range(len(layers)):
                wy, gy = pick(j, wy0, wy1, wy2), pick(j, gy0, gy1, gy2)
                flat = (wx * wy) * constant + (gx * wy) * along_x + (wx * gy) * along_y
                steep = (wx * wy) * along_z
                node = ((bx + i) * ny + by + j) * nz + bz
                store_row(grid, node, load_row(grid, node) + wz0 * flat + gz0 * steep)
                store_row(grid, node + 1, load_row(grid, node + 1) + wz1 * flat + gz1 * steep)
                store_row(grid, node + 2, load_row(grid, node + 2) + wz2 * flat + gz2 * steep)
        note_gaps(px, py, pz, bx, by, bz, gap, cells, nodes, inverse_cell, obstacles, layers)


@compiled
def update_point(
    p, vx, vy, vz, cx, cy, cz, lxx, lxy, lxz, lyx, lyy, lyz, lzx, lzy, lzz, position, velocity, affine, stress,
    material_index, materials, cells, inverse_cell, obstacles, layers, flip_fraction, dt,
):  # fmt: skip
    """Move one point and update its velocity and stress.

    Args:
        p: the point.
        vx, vy, vz: velocity of the grid at the point [m/s].
        cx, cy, cz: change of that velocity in this step [m/s].
        lxx, …, lzz: gradient of that velocity [1/s].
        position, …, dt: as in `grid_to_points`.

    Returns:
        Number of its coordinates beyond a wall.
    """
    px, py, pz = position[p, 0], position[p, 1], position[p, 2]
    ihx, ihy, ihz = inverse_cell
    left = 0
    velocity[p, 0] = flip_fraction * (velocity[p, 0] + cx) + (1.0 - flip_fraction) * vx
    velocity[p, 1] = flip_fraction * (velocity[p, 1] + cy) + (1.0 - flip_fraction) * vy
    velocity[p, 2] = flip_fraction * (velocity[p, 2] + cz) + (1.0 - flip_fraction) * vz
    affine[p, 0], affine[p, 1], affine[p, 2] = lxx, lxy, lxz
    affine[p, 3], affine[p, 4], affine[p, 5] = lyx, lyy, lyz
    affine[p, 6], affine[p, 7], affine[p, 8] = lzx, lzy, lzz
    ux, uy, uz = dt * vx, dt * vy, dt * vz
    for o in range(obstacles.shape[0]):
        ux, uy, uz = approach_obstacle(
            obstacles[o], px / ihx, py / ihy, pz / ihz, ux, uy, uz, WALL_REACH / max(ihx, ihz)
        )
    position[p, 0], beyond = keep_inside(approach_wall(px, ihx * ux, cells[0]), cells[0])
    left += beyond
    if len(layers) == 3:
        position[p, 1], beyond = keep_inside(approach_wall(py, ihy * uy, cells[1]), cells[1])
        left += beyond
    position[p, 2], beyond = keep_inside(approach_wall(pz, ihz * uz, cells[2]), cells[2])
    left += beyond
    row = materials[material_index[p]]
    (
        stress[p, 0], stress[p, 1], stress[p, 2], stress[p, 3], stress[p, 4], stress[p, 5], stress[p, 6],
    ) = update_stress(
        stress[p, 0], stress[p, 1], stress[p, 2], stress[p, 3], stress[p, 4], stress[p, 5], stress[p, 6],
        lxx, lxy, lxz, lyx, lyy, lyz, lzx, lzy, lzz, dt, row[0], row[1], row[2], row[3], row[4], row[5],
    )  # fmt: skip
    return left


@compiled
def grid_to_points(
    first, last, position, velocity, affine, stress, material_index, materials,
    grid, cells, nodes, inverse_cell, obstacles, layers, flip_fraction, dt,
):  # fmt: skip
    """Give velocity and velocity gradient back to points, move them and update their stresses.

    Args:
        first, last: of the points.
        position, velocity, affine, stress, material_index, materials: as in `points_to_grid`.
        grid: velocities and their changes, from `grid.move_nodes`.
        cells, nodes, inverse_cell, obstacles, layers: as in `points_to_grid`.
        flip_fraction: α above; 0 is APIC (or PIC).
        dt: time step [s].

    Returns:
        Number of coordinates beyond a wall, which are put back. `shape.approach_wall` carries no point through a wall
        at any accepted time step.
    """
    ihx, ihy, ihz = inverse_cell
    ny, nz = nodes[1], nodes[2]
    left = 0
    for p in range(first, last):
        px, py, pz = position[p, 0], position[p, 1], position[p, 2]
        bx, wx0, wx1, wx2, gx0, gx1, gx2, _ = axis_shape(px, cells[0])
        bz, wz0, wz1, wz2, gz0, gz1, gz2, _ = axis_shape(pz, cells[2])
        if len(layers) == 3:
            by, wy0, wy1, wy2, gy0, gy1, gy2, _ = axis_shape(py, cells[1])
        else:
            by, wy0, wy1, wy2, gy0, gy1, gy2 = 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        none = real(0.0)
        value = make_row(none, none, none, none, none, none, none, none)
        slope_x = slope_y = slope_z = first_half(value)  # of the velocity alone
        for i in range(3):
            wx, gx = pick(i, wx0, wx1, wx2), pick(i, gx0, gx1, gx2)
            for j in range(len(layers)):
                wy, gy = pick(j, wy0, wy1, wy2), pick(j, gy0, gy1, gy2)
                node = ((bx + i) * ny + by + j) * nz + bz
                low, middle, high = load_row(grid, node), load_row(grid, node + 1), load_row(grid, node + 2)
                flat = wz0 * low + wz1 * middle + wz2 * high
                value = value + (wx * wy) * flat
                velocity_alone = first_half(flat)
                slope_x = slope_x + (gx * wy) * velocity_alone
                slope_y = slope_y + (wx * gy) * velocity_alone
                steep = gz0 * first_half(low) + gz1 * first_half(middle) + gz2 * first_half(high)
                slope_z = slope_z + (wx * wy) * steep
        vx, vy, vz = lane(value, 0), lane(value, 1), lane(value, 2)
        cx, cy, cz = lane(value, 4), lane(value, 5), lane(value, 6)
        lxx, lyx, lzx = ihx * lane(slope_x, 0), ihx * lane(slope_x, 1), ihx * lane(slope_x, 2)
        lxy, lyy, lzy = ihy * lane(slope_y, 0), ihy * lane(slope_y, 1), ihy * lane(slope_y, 2)
        lxz, lyz, lzz = ihz * lane(slope_z, 0), ihz * lane(slope_z, 1), ihz * lane(slope_z, 2)
        left += update_point(
            p, vx, vy, vz, cx, cy, cz, lxx, lxy, lxz, lyx, lyy, lyz, lzx, lzy, lzz, position, velocity, affine, stress,
            material_index, materials, cells, inverse_cell, obstacles, layers, flip_fraction, dt,
        )  # fmt: skip
    return left


@compiled
def keep_inside(x, num_cells):
    """Return a coordinate inside the box [cells] and 1 if it lay beyond a wall, else 0.

    The comparisons are written so that NaN lands inside too: it must not become an address. It stays visible in the
    velocity.
    """
    if not x >= WALL_MARGIN:
        return WALL_MARGIN, 0 if x >= 0.0 else 1
    high = real(num_cells) - WALL_MARGIN
    if not x <= high:
        return high, 0 if x <= real(num_cells) else 1
    return x, 0
