"""Time steps of a layer on a grid: what friction holds at rest, the two stages of a step, rain, and friction last."""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from gns_pl.shallow.compiled import compiled
from gns_pl.shallow.flux import DRY, add_line

SETTLED = 1e-3
"""Share by which a surface at rest may be steeper than friction holds, so that a deposit comes to rest in finite time
and not only in the limit."""

ROUNDING = 1e-13
"""A thickness down to minus this is rounding and becomes zero [m]; one that is more negative halves the step."""

RAIN_STEPS = 100
"""Least number of steps in which rain comes down: onto a dry floor nothing else limits the first of them."""


@compiled
def level_difference(h, bed, cell, other, slope):
    """Return by how much the surface is higher in another cell, as far as the layers meet above both beds [m].

    On a terrain the bed goes on from cell to cell: there a layer that is thinner than the bed's drop lies on a slope
    and not on a step, and what counts is the whole difference, where there is something to flow down it.

    Args:
        slope: difference of beds up to which this is so [m]; negative without a terrain.
    """
    if abs(bed[other] - bed[cell]) <= slope:
        rise = h[other] + bed[other] - h[cell] - bed[cell]
        return rise if h[other if rise > 0.0 else cell] > DRY else 0.0
    floor = max(bed[cell], bed[other])
    return max(h[other] + bed[other] - floor, 0.0) - max(h[cell] + bed[cell] - floor, 0.0)


@compiled
def central_slope(h, bed, cell, place, number, stride, width, cliff):
    """Return the slope of the surface in a cell, walls as mirrors.

    Args:
        cell, place, number, stride: index, place along the axis, number of cells along it and their stride.
        width: of a cell along the axis [m].
        cliff: as of `is_held`.
    """
    rise = 0.0
    if place > 0:
        rise -= level_difference(h, bed, cell, cell - stride, cliff * width)
    if place < number - 1:
        rise += level_difference(h, bed, cell, cell + stride, cliff * width)
    return 0.5 * rise / width


@compiled
def is_held(h, qx, qy, bed, friction, one, two, x_axis, i, j, nx, ny, dx, dy, cliff):
    """Tell whether friction holds the two cells of a face: both at rest, the surface no steeper than tan δ.

    Args:
        one, two: the cells; (i, j) are the indices of `one`, and `x_axis` tells whether `two` is beside it along x.
        cliff: differences of the beds up to so many cells are slopes; negative: all are steps.
    """
    if qx[one] != 0.0 or qy[one] != 0.0 or qx[two] != 0.0 or qy[two] != 0.0:
        return False
    across, wet, limit = 0.0, 0, math.inf
    for cell in (one, two):
        if h[cell] > DRY:
            wet += 1
            limit = min(limit, friction[cell])
            if x_axis:
                across += central_slope(h, bed, cell, j, ny, 1, dy, cliff)
            else:
                across += central_slope(h, bed, cell, i, nx, ny, dx, cliff)
    if wet == 0:
        return True
    across /= wet
    width = dx if x_axis else dy
    along = level_difference(h, bed, one, two, cliff * width) / width
    return along * along + across * across <= (limit * (1.0 + SETTLED)) ** 2


@compiled
def hold(h, qx, qy, bed, friction, frozen_x, frozen_y, nx, ny, dx, dy, cliff):
    """Mark the faces through which nothing passes; return whether that is all of them, so that nothing moves."""
    everything = True
    for i in range(nx):
        for j in range(ny):
            cell = i * ny + j
            if i < nx - 1:
                held = is_held(h, qx, qy, bed, friction, cell, cell + ny, True, i, j, nx, ny, dx, dy, cliff)
                frozen_x[(i + 1) * ny + j] = 1 if held else 0
                everything = everything and held
            if j < ny - 1:
                held = is_held(h, qx, qy, bed, friction, cell, cell + 1, False, i, j, nx, ny, dx, dy, cliff)
                frozen_y[i * (ny + 1) + j + 1] = 1 if held else 0
                everything = everything and held
            everything = everything and qx[cell] == 0.0 and qy[cell] == 0.0
    return everything


@compiled
def fill_rates(h, qx, qy, bed, gravity, curve, frozen_x, frozen_y, u, v, dh, dqx, dqy, nx, ny, dx, dy, cliff):
    """Compute the rates of change of thickness and momentum without friction."""
    for cell in range(nx * ny):
        wet = h[cell] > DRY
        u[cell] = qx[cell] / h[cell] if wet else 0.0
        v[cell] = qy[cell] / h[cell] if wet else 0.0
        dh[cell] = dqx[cell] = dqy[cell] = 0.0
    for j in range(ny):
        add_line(h, u, v, bed, gravity, curve, frozen_x, dh, dqx, dqy, j, ny, nx, j, ny, dx, cliff)
    if ny > 1:
        for i in range(nx):
            add_line(h, v, u, bed, gravity, curve, frozen_y, dh, dqy, dqx, i * ny, 1, ny, i * (ny + 1), 1, dy, cliff)


@compiled
def largest_rate(h, qx, qy, gravity, nx, ny, dx, dy):
    """Return the largest (speed + wave speed) / cell of all cells and axes [1/s]; 0 where all is dry."""
    rate = 0.0
    for cell in range(nx * ny):
        if h[cell] > DRY:
            wave = math.sqrt(gravity[cell] * h[cell])
            rate = max(rate, (abs(qx[cell]) / h[cell] + wave) / dx)
            if ny > 1:
                rate = max(rate, (abs(qy[cell]) / h[cell] + wave) / dy)
    return rate


@compiled
def rise_rate(u, v, curve):
    """Return the vertical acceleration of what slides over curved ground, u² b_xx + 2 u v b_xy + v² b_yy [m/s²].

    Args:
        u, v: velocity [m/s].
        curve: of the cell, see `advance`.
    """
    return u * u * curve[2] + 2.0 * u * v * curve[3] + v * v * curve[4]


@compiled
def path_factor(x, y, size, curve):
    """Return how much more than down the fall line friction is along a direction: the path is shorter across it.

    √((1 + |∇b|²) / (1 + (∇b · u)² / |u|²)); gravity has cos²θ already.

    Args:
        x, y: direction, as momentum, and `size` its length.
        curve: of the cell, see `advance`.
    """
    along = (x * curve[0] + y * curve[1]) / size
    return math.sqrt((1.0 + curve[0] * curve[0] + curve[1] * curve[1]) / (1.0 + along * along))


@compiled
def moved(h, qx, qy, dh, dqx, dqy, u, v, gravity, friction, curve, drag, fall, step, new_h, new_qx, new_qy):
    """Write a state after an Euler step and friction, which takes at most the momentum there is.

    Curved ground turns the velocity, −cos²θ a ∇b with a of `rise_rate`, by which a slide keeps its speed around a bend,
    and presses harder or less, g + a, at least 0; the layer's own pressure stays that of gravity.

    Drag comes after it, implicitly: the new u has u (1 + step · drag |u| / h) as the old one.

    Returns:
        The least thickness [m].
    """
    least = math.inf
    for cell in range(len(h)):
        thickness = h[cell] + step * dh[cell]
        x, y = qx[cell] + step * dqx[cell], qy[cell] + step * dqy[cell]
        least = min(least, thickness)
        taken = friction[cell] * gravity[cell] * thickness * step
        if len(curve) > 0:
            bend = curve[cell]
            rise = rise_rate(u[cell], v[cell], bend)
            turn = step * h[cell] * rise / (1.0 + bend[0] * bend[0] + bend[1] * bend[1])
            x, y = x - turn * bend[0], y - turn * bend[1]
            if x != 0.0 or y != 0.0:
                taken *= max(1.0 + rise / fall, 0.0) * path_factor(x, y, math.hypot(x, y), bend)
        size = math.hypot(x, y)
        left = 1.0 - taken / size if size > taken and thickness > DRY else 0.0
        if len(drag) > 0 and left > 0.0:
            left *= 2.0 / (1.0 + math.sqrt(1.0 + 4.0 * step * drag[cell] * left * size / (thickness * thickness)))
        new_h[cell] = thickness if thickness > 0.0 else 0.0
        new_qx[cell], new_qy[cell] = left * x, left * y
    return least


@compiled
def advance(state, ground, rain, fall, shape, sizes, courant, time, end):
    """Go on from `time` to `end`.

    A step is Heun's method (strong stability preserving, Shu and Osher 1988) of two Euler steps with friction last.
    What the second of them stops has stopped. The rain comes down after it.

    Args:
        state: thickness [C] [m], momentum along x and y [C] [m²/s]; changed.
        ground: height of the bed [C] [m], effective gravity [C] [m/s²], friction [C]; of curved ground its slopes along
            x and y, the second derivatives xx, xy and yy of its height, and by how much its bed may miss those of the
            cells beside it [C, 6], else [0, 6]; drag g / (ξ cos²θ) [C] or [0]; rise of the bed in cells beyond which it
            is a step.
        rain: thickness that falls onto each cell in all [C] [m]. At time t, g t²/2 of it has fallen.
        fall: gravity of the fall [m/s²].
        shape: number of cells along x and y.
        sizes: edges of a cell along x and y [m].
        courant: Courant number.
        time, end: [s].

    Returns:
        Number of steps, −1 where no step is short enough, and whether all is at rest for good.
    """
    h, qx, qy = state
    bed, gravity, friction, curve, drag, cliff = ground
    (nx, ny), (dx, dy) = shape, sizes
    number = nx * ny
    one_h, one_qx, one_qy = np.empty(number), np.empty(number), np.empty(number)
    two_h, two_qx, two_qy = np.empty(number), np.empty(number), np.empty(number)
    dh, dqx, dqy, u, v = np.empty(number), np.empty(number), np.empty(number), np.empty(number), np.empty(number)
    frozen_x, frozen_y = np.zeros((nx + 1) * ny, np.uint8), np.zeros(nx * (ny + 1), np.uint8)
    smooth = cliff if len(curve) > 0 else -1.0
    rain_end = math.sqrt(2.0 * rain.max() / fall)
    steps = 0
    while time < end:
        at_rest = hold(h, qx, qy, bed, friction, frozen_x, frozen_y, nx, ny, dx, dy, smooth)
        if at_rest and time >= rain_end:
            return steps, True
        rate = largest_rate(h, qx, qy, gravity, nx, ny, dx, dy)
        step = end - time
        if rate * step > courant:
            step = courant / rate
        if time < rain_end:
            step = min(step, rain_end / RAIN_STEPS)
        shortest = 1e-9 * step
        while True:
            if step < shortest:
                return -1, False
            fill_rates(h, qx, qy, bed, gravity, curve, frozen_x, frozen_y, u, v, dh, dqx, dqy, nx, ny, dx, dy, cliff)
            least = moved(
                h, qx, qy, dh, dqx, dqy, u, v, gravity, friction, curve, drag, fall, step,
                one_h, one_qx, one_qy,
            )  # fmt: skip
            if least >= -ROUNDING:
                fill_rates(
                    one_h, one_qx, one_qy, bed, gravity, curve, frozen_x, frozen_y, u, v, dh, dqx, dqy, nx, ny, dx, dy,
                    cliff,
                )  # fmt: skip
                least = moved(
                    one_h, one_qx, one_qy, dh, dqx, dqy, u, v, gravity, friction, curve, drag, fall, step,
                    two_h, two_qx, two_qy,
                )  # fmt: skip
                if least >= -ROUNDING:
                    break
            step *= 0.5
        later = end if step == end - time else time + step
        for cell in range(number):
            h[cell] = 0.5 * (h[cell] + two_h[cell])
            stopped = two_qx[cell] == 0.0 and two_qy[cell] == 0.0
            qx[cell] = 0.0 if stopped else 0.5 * (qx[cell] + two_qx[cell])
            qy[cell] = 0.0 if stopped else 0.5 * (qy[cell] + two_qy[cell])
            if rain[cell] > 0.0:
                h[cell] += min(0.5 * fall * later * later, rain[cell]) - min(0.5 * fall * time * time, rain[cell])
        time = later
        steps += 1
    return steps, False
