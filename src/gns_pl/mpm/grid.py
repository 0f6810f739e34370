"""The grid between the two transfers, and the loop over steps that joins all three, on one thread or several.

Threads share points and nodes without races and without a trace: points are sorted into blocks of `BLOCK` × `BLOCK`
columns of cells, blocks of one of four colours (two in the plane) touch no node together, and colours are taken in
turn. So every node adds up its points in the same order however many threads there are, and the bits are the same.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numba import prange

from gns_pl.mpm.compiled import compiled, variant
from gns_pl.mpm.ground import GROUND_NAMES
from gns_pl.mpm.laws import DRUCKER_PRAGER, Law, find_law, law_names
from gns_pl.mpm.obstacles import OBSTACLE_BAND, hold_at_obstacle
from gns_pl.mpm.shape import linear_axis_shape
from gns_pl.mpm.transfer import grid_to_points, points_to_grid
from gns_pl.mpm.walls import clearance, hold_at_walls

BLOCK = 3
"""Edge of a block in cells. A point in cell c reaches nodes c − 1 … c + 2, so 3 is the least at which blocks that are
not neighbours share no node."""

real = np.float64
INFINITY = math.inf


@compiled
def sort_points(position, cells, nodes, order, block, start):
    """Sort points by blocks, keeping their order within one.

    Args:
        position: [N, 3] in cells.
        cells, nodes: per axis.
        order: [N] becomes the sorted indices.
        block: [N] becomes the block of every point, X · (blocks along y) + Y.
        start: [blocks + 1] becomes the first place of every block in `order`, and N.

    Returns:
        First and last-plus-one node per axis that points can reach (x0, x1, y0, y1, z0, z1).
    """
    along_y = cells[1] // BLOCK + 1
    start[:] = 0
    x0 = y0 = z0 = INFINITY
    x1 = y1 = z1 = 0.0
    for p in range(position.shape[0]):
        x, y, z = position[p, 0], position[p, 1], position[p, 2]
        x0, x1, y0, y1, z0, z1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y), min(z0, z), max(z1, z)
        block[p] = int(x) // BLOCK * along_y + int(y) // BLOCK
        start[block[p] + 1] += 1
    for b in range(start.shape[0] - 1):
        start[b + 1] += start[b]
    for p in range(position.shape[0]):
        order[start[block[p]]] = p
        start[block[p]] += 1
    for b in range(start.shape[0] - 1, 0, -1):
        start[b] = start[b - 1]
    start[0] = 0
    return (
        max(int(x0) - 1, 0), min(int(x1) + 3, nodes[0]),
        max(int(y0) - 1, 0), min(int(y1) + 3, nodes[1]),
        max(int(z0) - 1, 0), min(int(z1) + 3, nodes[2]),
    )  # fmt: skip


@compiled
def share_out(share, num_shares, first, last):
    """Return the part of [first, last) that a share of the work has."""
    return first + (last - first) * share // num_shares, first + (last - first) * (share + 1) // num_shares


@compiled
def clear_nodes(first, last, grid, gap, active, nodes):
    """Set active nodes to zero mass, momentum and impulse and to no point near.

    Args:
        first, last: of the layers of nodes along x.
        grid, gap, active, nodes: see `move_nodes`.
    """
    y0, y1, z0, z1 = active[2], active[3], active[4], active[5]
    for i in range(first, last):
        for j in range(y0, y1):
            row = (i * nodes[1] + j) * nodes[2]
            grid[row + z0 : row + z1] = 0.0
            gap[row + z0 : row + z1] = INFINITY


@compiled
def scatter_blocks(
    share, num_shares, colour, start, order, position, velocity, affine, stress, mass, volume, material_index,
    materials, grid, gap, cells, nodes, inverse_cell, obstacles, layers, affine_fraction, dt,
):  # fmt: skip
    """Call `points_to_grid` on one share of the blocks of a colour, the shares having about as many points each.

    Args:
        share, num_shares: which part of the work this is.
        colour: 2 · (X mod 2) + (Y mod 2) of the blocks.
        start, order: from `sort_points`.
        position, …, dt: as in `points_to_grid`.
    """
    along_x, along_y = cells[0] // BLOCK + 1, cells[1] // BLOCK + 1
    total = 0
    for bx in range(colour // 2, along_x, 2):
        for by in range(colour % 2, along_y, 2):
            total += start[bx * along_y + by + 1] - start[bx * along_y + by]
    before = 0
    for bx in range(colour // 2, along_x, 2):
        for by in range(colour % 2, along_y, 2):
            first, last = start[bx * along_y + by], start[bx * along_y + by + 1]
            if first < last and share * total <= num_shares * before < (share + 1) * total:
                points_to_grid(
                    first, last, order, position, velocity, affine, stress, mass, volume, material_index, materials,
                    grid, gap, cells, nodes, inverse_cell, obstacles, layers, affine_fraction, dt,
                )  # fmt: skip
            before += last - first


@compiled
def move_nodes(
    first, last, grid, gap, active, cells, nodes, inverse_cell, gravity, friction, radius, obstacles, damping, dt
):
    """Turn momentum and impulse into velocity and its change, with gravity, damping, obstacles and walls.

    Args:
        first, last: of the layers of nodes along x.
        grid, gap: see `transfer`.
        active: from `sort_points`.
        cells, nodes, inverse_cell, obstacles: see `transfer.points_to_grid`.
        gravity: (x, y, z) [m/s²].
        friction: [3, 2] coefficient of the lower and upper face of each axis, or `walls.STICK`.
        radius: (x, y, z) half the spacing of the points [cells].
        damping: Cundall's local damping, the part by which each component of force on a node is lowered where it
            speeds the node up and raised where it slows it down.
        dt: time step [s].
    """
    y0, y1, z0, z1 = active[2], active[3], active[4], active[5]
    for i in range(first, last):
        for j in range(y0, y1):
            for k in range(z0, z1):
                move_node(
                    i, j, k, grid, gap, cells, nodes, inverse_cell, gravity, friction, radius, obstacles, damping, dt
                )


@compiled
def move_node(i, j, k, grid, gap, cells, nodes, inverse_cell, gravity, friction, radius, obstacles, damping, dt):
    """Do what `move_nodes` does at node (i, j, k)."""
    node = (i * nodes[1] + j) * nodes[2] + k
    m = grid[node, 3]
    if m == 0.0:
        return
    one = 1.0 / m
    ox, oy, oz = grid[node, 0] * one, grid[node, 1] * one, grid[node, 2] * one
    vx = ox + damped(grid[node, 4] * one + dt * gravity[0], ox, damping)
    vy = oy + damped(grid[node, 5] * one + dt * gravity[1], oy, damping)
    vz = oz + damped(grid[node, 6] * one + dt * gravity[2], oz, damping)
    for o in range(obstacles.shape[0]):
        vx, vy, vz = hold_at_obstacle(
            obstacles[o], real(i) / inverse_cell[0], real(j) / inverse_cell[1], real(k) / inverse_cell[2],
            gap[node, 3 + o], radius[0] / inverse_cell[0],
            OBSTACLE_BAND / max(inverse_cell[0], inverse_cell[2]), dt, vx, vy, vz,
        )  # fmt: skip
    sx = -1.0 if i == 0 else (1.0 if i == cells[0] else 0.0)
    sy = 0.0 if cells[1] == 0 else (-1.0 if j == 0 else (1.0 if j == cells[1] else 0.0))
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
def damped(change, velocity, damping):
    """Return a change of velocity after Cundall's local damping, Δ − β |Δ| sign v [m/s]."""
    if velocity > 0.0:
        return change - damping * abs(change)
    if velocity < 0.0:
        return change + damping * abs(change)
    return change


def advance_steps(
    position, velocity, affine, stress, mass, volume, material_index, materials, grid, gap, order, block, start,
    cells, nodes, inverse_cell, gravity, friction, radius, obstacles, layers, affine_fraction, flip_fraction, damping,
    dt, num_shares, num_steps,
):  # fmt: skip
    """Make `num_steps` explicit steps in place; arguments as in the functions called.

    Args:
        num_shares: into how many parts the work is cut; the number of threads.

    Returns:
        Number of coordinates that had to be put back inside the box.
    """
    left = 0
    for _ in range(num_steps):
        active = sort_points(position, cells, nodes, order, block, start)
        for share in prange(num_shares):
            first, last = share_out(share, num_shares, active[0], active[1])
            clear_nodes(first, last, grid, gap, active, nodes)
        for colour in range(4):
            if cells[1] > 0 or colour % 2 == 0:
                for share in prange(num_shares):
                    scatter_blocks(
                        share, num_shares, colour, start, order, position, velocity, affine, stress, mass, volume,
                        material_index, materials, grid, gap, cells, nodes, inverse_cell, obstacles, layers,
                        affine_fraction, dt,
                    )  # fmt: skip
        for share in prange(num_shares):
            first, last = share_out(share, num_shares, active[0], active[1])
            move_nodes(
                first, last, grid, gap, active, cells, nodes, inverse_cell, gravity, friction, radius, obstacles,
                damping, dt,
            )  # fmt: skip
        for share in prange(num_shares):
            first, last = share_out(share, num_shares, 0, position.shape[0])
            left += grid_to_points(
                first, last, position, velocity, affine, stress, material_index, materials,
                grid, cells, nodes, inverse_cell, obstacles, layers, flip_fraction, dt,
            )  # fmt: skip
    return left


advance = compiled(advance_steps)


SHAPES = {"quadratic": {}, "linear": {"axis_shape": linear_axis_shape}}
"""Shape functions → what names mean in their kernels."""


def make_advance(shape: str, precision: str, parallel: bool, law: str = DRUCKER_PRAGER, terrain: bool = False) -> Any:
    """Return `advance_steps` compiled for shape functions, floating type, threads, a material law and the ground.

    Args:
        shape: one of `SHAPES`.
        precision: "float64" or "float32".
        parallel: run its shares on threads of their own.
        law: as of `laws.find_law`.
        terrain: there is a heightfield among the obstacles.
    """
    return _make_advance(shape, precision, parallel, find_law(law), terrain)


@cache
def _make_advance(shape: str, precision: str, parallel: bool, law: Law | None, terrain: bool) -> Any:
    if shape == "quadratic" and precision == "float64" and law is None and not terrain:
        return compiled(advance_steps, "parallel", parallel=True) if parallel else advance
    name = f"{shape}-{precision}" + (f"-{law.digest}" if law else "") + ("-ground" if terrain else "")
    names = {**SHAPES[shape], **law_names(law), **(GROUND_NAMES if terrain else {})}
    kernel = variant(advance, precision, names, lambda function: compiled(function, name))
    return compiled(kernel.py_func, f"{name}-parallel", parallel=True) if parallel else kernel
