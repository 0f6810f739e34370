"""Shape functions along one axis: quadratic B-splines, or hat functions.

Lengths are in cells, counted from the lower wall; nodes are the whole numbers 0 … n, so both walls are nodes. In the
interior a point at x sees the nodes b, b + 1, b + 2 with b = ⌊x − 1/2⌋. Closer to a wall than half a cell the node
outside would be needed; it is replaced by the linear extrapolation of the two inside (Steffen, Kirby & Berzins 2008
treat boundaries likewise), which turns the three splines into the hat functions 1 − x and x. Values and first
derivatives stay continuous, and constants and linear fields stay exact.

The hat functions have one fault: at a wall, where the weight x of the inner node vanishes, its gradient stays 1; a lone
point on the floor would drive a node of almost no mass, and be thrown up. So a point acts on the grid from no nearer
than `WALL_REACH`, where g_i / w_i reaches its largest value in the interior, and `approach_wall` slows it from there on
as the hat functions would, so that it cannot go through the wall.

The gradient is the moving-least-squares one of Hu et al. 2018 (MLS-MPM), g_i = w_i (x_i − x) / D with the second moment
D = Σ w_i (x_i − x)²: 1/4 in the interior, x (1 − x) near a wall. Because g_i / w_i is bounded in the interior, nearly
empty cells do not limit the time step.

`linear_axis_shape` has the hat functions everywhere; for them the moving-least-squares gradient is their own. It jumps
where a point goes from cell to cell, and g_i / w_i is not bounded: the classical method, kept to show what it costs.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from gns_pl.mpm.compiled import compiled

real = np.float64

WALL_REACH = 1.0 / 6.0
"""Points act on the grid from no nearer to a wall than this [cells]."""


@compiled
def axis_shape(x, num_cells):
    """Return first node, three weights, three gradients and the second moment along one axis.

    Args:
        x: position in cells from the lower wall, 0 ≤ x ≤ num_cells.
        num_cells: number n ≥ 2 of cells along the axis.

    Returns:
        (b, w0, w1, w2, g0, g1, g2, D): weights [1], gradients [1/cell] of nodes b, b + 1, b + 2; D [cell²].
    """
    if x < 0.5:
        x = max(x, WALL_REACH)
        return 0, 1.0 - x, x, 0.0, -1.0, 1.0, 0.0, x * (1.0 - x)
    if x > real(num_cells) - 0.5:
        y = max(real(num_cells) - x, WALL_REACH)
        return num_cells - 2, 0.0, y, 1.0 - y, 0.0, -1.0, 1.0, y * (1.0 - y)
    base = min(int(x - 0.5), num_cells - 2)
    d = x - real(base)  # distance to the first node, in [1/2, 3/2]
    w0 = 0.5 * (1.5 - d) * (1.5 - d)
    w1 = 0.75 - (d - 1.0) * (d - 1.0)
    w2 = 0.5 * (d - 0.5) * (d - 0.5)
    return base, w0, w1, w2, -4.0 * w0 * d, 4.0 * w1 * (1.0 - d), 4.0 * w2 * (2.0 - d), 0.25


@compiled
def linear_axis_shape(x, num_cells):
    """Return the same as `axis_shape` for hat functions; the third node, or in the last cell the first, has weight 0.

    Args:
        x: position in cells from the lower wall, 0 ≤ x ≤ num_cells.
        num_cells: number n ≥ 2 of cells along the axis.
    """
    x = min(max(x, WALL_REACH), real(num_cells) - WALL_REACH)
    base = min(int(x), num_cells - 1)
    d = x - real(base)
    if base == num_cells - 1:
        return base - 1, 0.0, 1.0 - d, d, 0.0, -1.0, 1.0, d * (1.0 - d)
    return base, 1.0 - d, d, 0.0, -1.0, 1.0, 0.0, d * (1.0 - d)


@compiled
def approach_wall(x, step, num_cells):
    """Return the coordinate after a step, slowed on its last way to a wall [cells].

    Args:
        x: position in cells from the lower wall.
        step: displacement that the grid gives [cells].
        num_cells: number of cells along the axis.
    """
    if step < 0.0 and x < WALL_REACH:
        return x + step * (x / WALL_REACH)
    rest = real(num_cells) - x
    if step > 0.0 and rest < WALL_REACH:
        return x + step * (rest / WALL_REACH)
    return x + step


@compiled
def pick(index, a, b, c):
    """Return a, b or c for index 0, 1 or 2; the compiler removes it from an unrolled loop."""
    return a if index == 0 else (b if index == 1 else c)
