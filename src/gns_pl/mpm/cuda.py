"""The kernels of the solver on a GPU: one thread for every material point or grid node, many scenes in one launch.

What a point or a node does is taken from the CPU's sources (`compiled.variant`); only the loops around it are written
here, without the rows of `row`, which are for CPUs. Points add to nodes atomically, so sums are taken in another order
than on a CPU and in another one every time: results agree within rounding, not to the bit.

Points of all scenes lie behind each other in common arrays, and so do nodes; `scene` and `node_scene` tell whose they
are. What a scene does not share stands in its row of three tables, so that its result does not depend on the others:

==========  ===========================================================================================
whole       [S + 1, 8]  cells (3), nodes (3), first node, first obstacle; the last row ends those two
measure     [S, 13]     1 / cell (3) [1/m], gravity (3), radius (3) [cells], affine and FLIP fraction, damping, dt [s]
friction    [S, 3, 2]   as in `grid.move_nodes`
==========  ===========================================================================================

Arrays of points are as in `transfer`, but with one component after the other in memory, so that neighbouring threads
read neighbouring numbers. Beside them, `count_points`, `claim_places` and `carry_points` sort them by cell: then the
threads of a warp meet the same few nodes, which are in the cache. Each cell with points claims the next free stretch;
no sum over all cells is needed, and that stretches of cells far apart may become neighbours does no harm.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numba import cuda

from gns_pl.mpm.compiled import compiled, variant
from gns_pl.mpm.grid import SHAPES, move_node
from gns_pl.mpm.ground import GROUND_NAMES
from gns_pl.mpm.laws import Law, law_names
from gns_pl.mpm.shape import axis_shape, pick
from gns_pl.mpm.transfer import note_gaps, point_terms, update_point

CELLS, NODES, FIRST_NODE, FIRST_OBSTACLE = 0, 3, 6, 7
"""Columns of `whole`."""

INVERSE_CELL, GRAVITY, RADIUS, AFFINE_FRACTION, FLIP_FRACTION, DAMPING, DT = 0, 3, 6, 9, 10, 11, 12
"""Columns of `measure`."""

LEFT, FAST = 0, 1
"""Columns of `flags`: coordinates put back into the box in a frame, and whether a point is too fast at its end."""

LAYERS: tuple[int, ...] = (0, 1, 2)
"""As in `transfer`; the plane has another."""

real = np.float64
INFINITY = math.inf


@compiled
def lower_together(array, row, column, value):
    """Do what `transfer.lower` does, while others do so too."""
    if value < array[row, column]:  # mostly false, and it spares the costly atomic: entries are only ever lowered
        cuda.atomic.min(array, (row, column), value)


@compiled
def triple(table, row, column):
    """Return three neighbouring entries."""
    return table[row, column], table[row, column + 1], table[row, column + 2]


@compiled
def clear_node(step, steps, node_scene, grid, gap):
    """Set a node to zero and to no point near.

    Args:
        step: of this frame, from 0.
        steps: [S] in this frame; a scene that has made all of them rests, in every kernel.
        node_scene: [M] scene of each node.
        grid, gap: see `transfer`.
    """
    node = cuda.grid(1)
    if node >= node_scene.shape[0] or step >= steps[node_scene[node]]:
        return
    for column in range(grid.shape[1]):
        grid[node, column] = 0.0
    for column in range(gap.shape[1]):
        gap[node, column] = INFINITY


@compiled
def scatter_point(
    step, steps, scene, position, velocity, affine, stress, mass, volume, material_index, materials,
    grid, gap, whole, measure, obstacles,
):  # fmt: skip
    """Do what `transfer.points_to_grid` does for one point.

    Args:
        step, steps: see `clear_node`.
        scene: [N] scene of each point.
        position, …, gap: see `transfer`.
        whole, measure, obstacles: of all scenes.
    """
    p = cuda.grid(1)
    if p >= scene.shape[0] or step >= steps[scene[p]]:
        return
    s = scene[p]
    cells, nodes, inverse_cell = triple(whole, s, CELLS), triple(whole, s, NODES), triple(measure, s, INVERSE_CELL)
    px, py, pz = position[p, 0], position[p, 1], position[p, 2]
    bx, wx0, wx1, wx2, gx0, gx1, gx2, dx = axis_shape(px, cells[0])
    bz, wz0, wz1, wz2, gz0, gz1, gz2, dz = axis_shape(pz, cells[2])
    if len(LAYERS) == 3:
        by, wy0, wy1, wy2, gy0, gy1, gy2, dy = axis_shape(py, cells[1])
    else:
        by, wy0, wy1, wy2, gy0, gy1, gy2, dy = 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    constant, along_x, along_y, along_z = point_terms(
        p, velocity, affine, stress, mass, volume, material_index, materials, inverse_cell, dx, dy, dz,
        measure[s, AFFINE_FRACTION], measure[s, DT],
    )  # fmt: skip
    first = whole[s, FIRST_NODE]
    for i in range(3):
        wx, gx = pick(i, wx0, wx1, wx2), pick(i, gx0, gx1, gx2)
        for j in range(len(LAYERS)):
            wy, gy = pick(j, wy0, wy1, wy2), pick(j, gy0, gy1, gy2)
            node = first + ((bx + i) * nodes[1] + by + j) * nodes[2] + bz
            for k in range(3):
                wz, gz = pick(k, wz0, wz1, wz2), pick(k, gz0, gz1, gz2)
                w, x, y, z = wx * wy * wz, gx * wy * wz, wx * gy * wz, wx * wy * gz
                for c in range(3):
                    momentum = w * constant[c] + x * along_x[c] + y * along_y[c] + z * along_z[c]
                    impulse = x * along_x[3 + c] + y * along_y[3 + c] + z * along_z[3 + c]
                    cuda.atomic.add(grid, (node + k, c), momentum)
                    cuda.atomic.add(grid, (node + k, 4 + c), impulse)
                cuda.atomic.add(grid, (node + k, 3), w * constant[3])
    note_gaps(
        px, py, pz, bx, by, bz, gap[first : whole[s + 1, FIRST_NODE]], cells, nodes, inverse_cell,
        obstacles[whole[s, FIRST_OBSTACLE] : whole[s + 1, FIRST_OBSTACLE]], LAYERS,
    )  # fmt: skip


@compiled
def move_one_node(step, steps, node_scene, grid, gap, whole, measure, friction, obstacles):
    """Do what `grid.move_nodes` does for one node; arguments as in `scatter_point`."""
    node = cuda.grid(1)
    if node >= node_scene.shape[0] or step >= steps[node_scene[node]] or grid[node, 3] == 0.0:
        return
    s = node_scene[node]
    cells, nodes = triple(whole, s, CELLS), triple(whole, s, NODES)
    first, last = whole[s, FIRST_NODE], whole[s + 1, FIRST_NODE]
    column, k = (node - first) // nodes[2], (node - first) % nodes[2]
    move_node(
        column // nodes[1], column % nodes[1], k, grid[first:last], gap[first:last], cells, nodes,
        triple(measure, s, INVERSE_CELL), triple(measure, s, GRAVITY), friction[s], triple(measure, s, RADIUS),
        obstacles[whole[s, FIRST_OBSTACLE] : whole[s + 1, FIRST_OBSTACLE]], measure[s, DAMPING], measure[s, DT],
    )  # fmt: skip


@compiled
def gather_point(
    step, steps, scene, position, velocity, affine, stress, material_index, materials,
    grid, whole, measure, obstacles, flags,
):  # fmt: skip
    """Do what `transfer.grid_to_points` does for one point; arguments as in `scatter_point`.

    Args:
        flags: [S, 2]; `LEFT` is raised by the number of coordinates put back.
    """
    p = cuda.grid(1)
    if p >= scene.shape[0] or step >= steps[scene[p]]:
        return
    s = scene[p]
    cells, nodes, inverse_cell = triple(whole, s, CELLS), triple(whole, s, NODES), triple(measure, s, INVERSE_CELL)
    bx, wx0, wx1, wx2, gx0, gx1, gx2, _ = axis_shape(position[p, 0], cells[0])
    bz, wz0, wz1, wz2, gz0, gz1, gz2, _ = axis_shape(position[p, 2], cells[2])
    if len(LAYERS) == 3:
        by, wy0, wy1, wy2, gy0, gy1, gy2, _ = axis_shape(position[p, 1], cells[1])
    else:
        by, wy0, wy1, wy2, gy0, gy1, gy2 = 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    vx = vy = vz = cx = cy = cz = real(0.0)
    lxx = lxy = lxz = lyx = lyy = lyz = lzx = lzy = lzz = real(0.0)
    first = whole[s, FIRST_NODE]
    for i in range(3):
        wx, gx = pick(i, wx0, wx1, wx2), pick(i, gx0, gx1, gx2)
        for j in range(len(LAYERS)):
            wy, gy = pick(j, wy0, wy1, wy2), pick(j, gy0, gy1, gy2)
            node = first + ((bx + i) * nodes[1] + by + j) * nodes[2] + bz
            for k in range(3):
                wz, gz = pick(k, wz0, wz1, wz2), pick(k, gz0, gz1, gz2)
                w, x, y, z = wx * wy * wz, gx * wy * wz, wx * gy * wz, wx * wy * gz
                ux, uy, uz = triple(grid, node + k, 0)
                ax, ay, az = triple(grid, node + k, 4)
                vx, vy, vz = vx + w * ux, vy + w * uy, vz + w * uz
                cx, cy, cz = cx + w * ax, cy + w * ay, cz + w * az
                lxx, lyx, lzx = lxx + x * ux, lyx + x * uy, lzx + x * uz
                lxy, lyy, lzy = lxy + y * ux, lyy + y * uy, lzy + y * uz
                lxz, lyz, lzz = lxz + z * ux, lyz + z * uy, lzz + z * uz
    ihx, ihy, ihz = inverse_cell
    left = update_point(
        p, vx, vy, vz, cx, cy, cz, ihx * lxx, ihy * lxy, ihz * lxz, ihx * lyx, ihy * lyy, ihz * lyz,
        ihx * lzx, ihy * lzy, ihz * lzz, position, velocity, affine, stress, material_index, materials,
        cells, inverse_cell, obstacles[whole[s, FIRST_OBSTACLE] : whole[s + 1, FIRST_OBSTACLE]], LAYERS,
        measure[s, FLIP_FRACTION], measure[s, DT],
    )  # fmt: skip
    if left > 0:
        cuda.atomic.add(flags, (s, LEFT), left)


@compiled
def judge_point(scene, velocity, largest, flags):
    """Raise the flag `FAST` of a scene if its point is faster than `largest` [S] [m/s], or NaN."""
    p = cuda.grid(1)
    if p >= scene.shape[0]:
        return
    vx, vy, vz = triple(velocity, p, 0)
    if not math.sqrt(vx * vx + vy * vy + vz * vz) <= largest[scene[p]]:
        flags[scene[p], FAST] = 1


@compiled
def place_point(scene, original, position, box, place):
    """Write where a point is.

    Args:
        scene: [N] scene of each point.
        original: [N] the point's index at the start.
        position: see `transfer`.
        box: [S, 6] lower corner and edges of a cell [m].
        place: [N, 3] becomes the positions in the order of the start [m].
    """
    p = cuda.grid(1)
    if p < scene.shape[0]:
        for axis in range(3):
            place[original[p], axis] = box[scene[p], axis] + position[p, axis] * box[scene[p], 3 + axis]


@compiled
def home(p, scene, position, whole):
    """Return the node at the lower corner of a point's cell."""
    s = scene[p]
    i, j, k = int(position[p, 0]), int(position[p, 1]), int(position[p, 2])
    return whole[s, FIRST_NODE] + (i * whole[s, NODES + 1] + j) * whole[s, NODES + 2] + k


@compiled
def clear_counts(count, free):
    """Set `count`, and the places given away, to zero."""
    node = cuda.grid(1)
    if node < count.shape[0]:
        count[node] = 0
    if node == 0:
        free[0] = 0


@compiled
def count_points(scene, position, whole, count):
    """Add a point to the number in its cell; `count` is [M]."""
    p = cuda.grid(1)
    if p < scene.shape[0]:
        cuda.atomic.add(count, home(p, scene, position, whole), 1)


@compiled
def claim_places(count, free):
    """Turn the number of points in a cell into their first place; `free` is [1], the places given away."""
    node = cuda.grid(1)
    if node < count.shape[0] and count[node] > 0:
        count[node] = cuda.atomic.add(free, 0, count[node])


@compiled
def carry_point(
    whole, count, scene, original, position, velocity, affine, stress, mass, volume, material_index,
    new_scene, new_original, new_position, new_velocity, new_affine, new_stress, new_mass, new_volume,
    new_material_index,
):  # fmt: skip
    """Copy a point to the next place of its cell; `count` comes from `claim_places`."""
    p = cuda.grid(1)
    if p >= scene.shape[0]:
        return
    q = cuda.atomic.add(count, home(p, scene, position, whole), 1)
    new_scene[q], new_original[q], new_material_index[q] = scene[p], original[p], material_index[p]
    new_mass[q], new_volume[q] = mass[p], volume[p]
    for c in range(3):
        new_position[q, c], new_velocity[q, c] = position[p, c], velocity[p, c]
    for c in range(9):
        new_affine[q, c] = affine[p, c]
    for c in range(7):
        new_stress[q, c] = stress[p, c]


KERNELS = (
    clear_node, scatter_point, move_one_node, gather_point, judge_point, place_point,
    clear_counts, count_points, claim_places, carry_point,
)  # fmt: skip
"""All that are launched; what they call are device functions. `compiled` makes them sources for `variant`, no more."""


@cache
def make_kernels(shape: str, precision: str, dim: int, law: Law | None = None, terrain: bool = False) -> dict[str, Any]:
    """Return the `KERNELS` by name, for shape functions, floating type, dimension, material law and the ground."""
    launched = {kernel.py_func.__name__ for kernel in KERNELS}
    names = {**SHAPES[shape], **law_names(law), "lower": lower_together, "LAYERS": (0,) if dim == 2 else (0, 1, 2)}
    names |= GROUND_NAMES if terrain else {}
    made = [
        variant(kernel, precision, names, lambda function: cuda.jit(function, device=function.__name__ not in launched))
        for kernel in KERNELS
    ]
    return {kernel.py_func.__name__: one for kernel, one in zip(KERNELS, made, strict=True)}
