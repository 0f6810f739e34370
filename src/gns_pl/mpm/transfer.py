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
from gns_pl.mpm.shape import WALL_REACH, approach_wall, axis_shape, pick

real = np.float64

WALL_MARGIN = 1e-3
"""Points are kept this far from a wall, in cells."""

OBSTACLE_REACH = 2.6
"""Points farther than this from an obstacle [cells] see no node inside it: 1.5 √3."""


@compiled
def add(array, row, column, value):
    """Add to one entry; on a GPU, where many points do at once, an atomic addition stands here."""
    array[row, column] += value


@compiled
def lower(array, row, column, value):
    """Lower one entry to `value` if it is larger; on a GPU atomic."""
    array[row, column] = min(array[row, column], value)


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
    ihx, ihy, ihz = inverse_cell
    ny, nz = nodes[1], nodes[2]
    reach = OBSTACLE_REACH / min(ihx, ihz) if len(layers) == 1 else OBSTACLE_REACH / min(ihx, ihy, ihz)
    for place in range(first, last):
        p = order[place]
        px, py, pz = position[p, 0], position[p, 1], position[p, 2]
        bx, wx0, wx1, wx2, gx0, gx1, gx2, dx = axis_shape(px, cells[0])
        bz, wz0, wz1, wz2, gz0, gz1, gz2, dz = axis_shape(pz, cells[2])
        if len(layers) == 3:
            by, wy0, wy1, wy2, gy0, gy1, gy2, dy = axis_shape(py, cells[1])
        else:
            by, wy0, wy1, wy2, gy0, gy1, gy2, dy = 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
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
        mvx, mvy, mvz = m * velocity[p, 0], m * velocity[p, 1], m * velocity[p, 2]
        for i in range(3):
            wx, gx = pick(i, wx0, wx1, wx2), pick(i, gx0, gx1, gx2)
            for j in range(len(layers)):
                wy, gy = pick(j, wy0, wy1, wy2), pick(j, gy0, gy1, gy2)
                w, a, b = wx * wy, gx * wy, wx * gy
                aa, bb, cc = a * ax, b * ay, w * az
                p0 = w * mvx + aa * affine[p, 0] + bb * affine[p, 1]
                p1 = w * mvy + aa * affine[p, 3] + bb * affine[p, 4]
                p2 = w * mvz + aa * affine[p, 6] + bb * affine[p, 7]
                q0, q1, q2 = cc * affine[p, 2], cc * affine[p, 5], cc * affine[p, 8]
                r0, r1, r2 = a * fxx + b * fxy, a * fyx + b * fyy, a * fzx + b * fzy
                s0, s1, s2 = w * fxz, w * fyz, w * fzz
                wm = w * m
                node = ((bx + i) * ny + by + j) * nz + bz
                for k in range(3):
                    wz, gz = pick(k, wz0, wz1, wz2), pick(k, gz0, gz1, gz2)
                    add(grid, node + k, 0, wz * p0 + gz * q0)
                    add(grid, node + k, 1, wz * p1 + gz * q1)
                    add(grid, node + k, 2, wz * p2 + gz * q2)
                    add(grid, node + k, 3, wz * wm)
                    add(grid, node + k, 4, wz * r0 + gz * s0)
                    add(grid, node + k, 5, wz * r1 + gz * s1)
                    add(grid, node + k, 6, wz * r2 + gz * s2)
        # A point whose stencil reaches a wall is within a cell and a half of it.
        top = bx + 2 == cells[0]
        if bx == 0 or top:
            distance = cells[0] - px if top else px
            for j in range(len(layers)):
                for k in range(3):
                    node = ((cells[0] if top else 0) * ny + by + j) * nz + bz + k
                    lower(gap, node, 0, distance)
        if len(layers) == 3:
            top = by + 2 == cells[1]
            if by == 0 or top:
                distance = cells[1] - py if top else py
                for i in range(3):
                    for k in range(3):
                        node = ((bx + i) * ny + (cells[1] if top else 0)) * nz + bz + k
                        lower(gap, node, 1, distance)
        top = bz + 2 == cells[2]
        if bz == 0 or top:
            distance = cells[2] - pz if top else pz
            for i in range(3):
                for j in range(len(layers)):
                    node = ((bx + i) * ny + by + j) * nz + (cells[2] if top else 0)
                    lower(gap, node, 2, distance)
        for o in range(obstacles.shape[0]):
            distance = signed_distance(obstacles[o], px / ihx, py / ihy, pz / ihz)[0]
            if distance < reach:
                for i in range(3):
                    for j in range(len(layers)):
                        node = ((bx + i) * ny + by + j) * nz + bz
                        for k in range(3):
                            lower(gap, node + k, 3 + o, distance)


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
        vx = vy = vz = cx = cy = cz = 0.0
        lxx = lxy = lxz = lyx = lyy = lyz = lzx = lzy = lzz = 0.0
        for i in range(3):
            wx, gx = pick(i, wx0, wx1, wx2), pick(i, gx0, gx1, gx2)
            for j in range(len(layers)):
                wy, gy = pick(j, wy0, wy1, wy2), pick(j, gy0, gy1, gy2)
                node = ((bx + i) * ny + by + j) * nz + bz
                # Sums along z first: velocity, its z gradient and its change.
                u0 = wz0 * grid[node, 0] + wz1 * grid[node + 1, 0] + wz2 * grid[node + 2, 0]
                u1 = wz0 * grid[node, 1] + wz1 * grid[node + 1, 1] + wz2 * grid[node + 2, 1]
                u2 = wz0 * grid[node, 2] + wz1 * grid[node + 1, 2] + wz2 * grid[node + 2, 2]
                d0 = gz0 * grid[node, 0] + gz1 * grid[node + 1, 0] + gz2 * grid[node + 2, 0]
                d1 = gz0 * grid[node, 1] + gz1 * grid[node + 1, 1] + gz2 * grid[node + 2, 1]
                d2 = gz0 * grid[node, 2] + gz1 * grid[node + 1, 2] + gz2 * grid[node + 2, 2]
                c0 = wz0 * grid[node, 4] + wz1 * grid[node + 1, 4] + wz2 * grid[node + 2, 4]
                c1 = wz0 * grid[node, 5] + wz1 * grid[node + 1, 5] + wz2 * grid[node + 2, 5]
                c2 = wz0 * grid[node, 6] + wz1 * grid[node + 1, 6] + wz2 * grid[node + 2, 6]
                w, a, b = wx * wy, gx * wy, wx * gy
                vx, vy, vz = vx + w * u0, vy + w * u1, vz + w * u2
                cx, cy, cz = cx + w * c0, cy + w * c1, cz + w * c2
                lxx, lyx, lzx = lxx + a * u0, lyx + a * u1, lzx + a * u2
                lxy, lyy, lzy = lxy + b * u0, lyy + b * u1, lzy + b * u2
                lxz, lyz, lzz = lxz + w * d0, lyz + w * d1, lzz + w * d2
        lxx, lyx, lzx = ihx * lxx, ihx * lyx, ihx * lzx
        lxy, lyy, lzy = ihy * lxy, ihy * lyy, ihy * lzy
        lxz, lyz, lzz = ihz * lxz, ihz * lyz, ihz * lzz
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
