"""What goes through the faces of a line of cells: second-order reconstruction and the HLL flux.

One source serves both horizontal axes: arrays are flat, and a line of cells is a start and a stride. Velocities and
momenta come as normal and tangential to the faces.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

from gns_pl.shallow.compiled import compiled

DRY = 1e-10
"""A thinner layer does not move [m]."""


@compiled
def limited(before, after):
    """Return the monotonised central slope of two one-sided differences (van Leer 1977)."""
    if before * after <= 0.0:
        return 0.0
    slope = 0.5 * (before + after)
    most = 2.0 * min(abs(before), abs(after))
    return math.copysign(min(abs(slope), most), slope)


@compiled
def hll(hl, ul, gl, hr, ur, gr):
    """Return the flux of Harten, Lax and van Leer (1983) between two states, with wave speeds of Einfeldt (1988).

    The pressure is kept apart from the rest, since a bed that bends has another effective gravity on either side.

    Args:
        hl, hr: thickness on the lower and on the upper side [m].
        ul, ur: normal velocity [m/s].
        gl, gr: effective gravity [m/s²].

    Returns:
        Mass flux [m²/s], momentum flux without pressure [m³/s²], h²/2 [m²].
    """
    if hl <= 0.0 and hr <= 0.0:
        return 0.0, 0.0, 0.0
    cl, cr = math.sqrt(gl * hl), math.sqrt(gr * hr)
    if hl <= 0.0:
        lower, upper = ur - 2.0 * cr, ur + cr
    elif hr <= 0.0:
        lower, upper = ul - cl, ul + 2.0 * cl
    else:
        lower, upper = min(ul - cl, ur - cr), max(ul + cl, ur + cr)
    ql, qr = hl * ul, hr * ur
    if lower >= 0.0:
        return ql, ql * ul, 0.5 * hl * hl
    if upper <= 0.0:
        return qr, qr * ur, 0.5 * hr * hr
    span, product = 1.0 / (upper - lower), lower * upper
    return (
        (upper * ql - lower * qr + product * (hr - hl)) * span,
        (upper * ql * ul - lower * qr * ur + product * (qr - ql)) * span,
        0.5 * (upper * hl * hl - lower * hr * hr) * span,
    )


@compiled
def wall_force(h, outward, g):
    """Return the momentum flux at a wall: that of `hll` between a state and its mirror image, never a pull [m³/s²].

    Args:
        h: thickness at the wall [m].
        outward: velocity towards it [m/s].
        g: effective gravity [m/s²].
    """
    speed = abs(outward) + math.sqrt(g * h)
    return max(h * outward * outward + 0.5 * g * h * h + speed * h * outward, 0.0)


@compiled
def is_wall(h, bed, other_h, other_bed, jump):
    """Tell whether a layer meets a dry bed that stands above it, by more than `jump`, like a wall."""
    return other_h <= DRY and other_bed - bed > jump and h + bed <= other_bed


@compiled
def add_line(
    h, un, ut, bed, gravity, curve, frozen, dh, dn, dt, start, stride, number, face, face_stride, width, cliff
):
    """Add to the rates of change of a line of cells what flows through its faces and what its bed does.

    Surface, thickness and velocity are linear in a cell. At a face the layers are cut off at the higher bed, and what
    is cut off pushes on its own cell (hydrostatic reconstruction, Audusse et al. 2004): a level surface stays at rest.
    On a terrain the beds of two cells may meet in a step that the ground has not, a tooth of a saw. As much of it as
    the mean surface falls from cell to cell holds nothing back, or a thin layer would be caught on a slope; at a level
    surface, which does not fall, nothing changes.
    Velocities on the two sides of a cell are weighed so that its momentum is that of the linear pieces.

    Args:
        h, un, ut, bed, gravity: of every cell; thickness, velocities, height of the bed, effective gravity.
        curve: of every cell of a terrain, see `stepping.advance`; else empty.
        frozen: of every face, 1 where friction holds both its cells, so that nothing passes.
        dh, dn, dt: rates of thickness and of normal and tangential momentum, added to.
        start, stride, number: of the line's cells.
        face, face_stride: of the line's faces, one more than there are cells.
        width: of a cell along the line [m].
        cliff: a bed that rises by more than this many cells from one to the next is a step, and no slope.
    """
    over, jump = 1.0 / width, cliff * width
    last, last_h, last_e, last_u, last_t = start, 0.0, 0.0, 0.0, 0.0  # the cell before, at its upper face
    for s in range(number + 1):
        cell = start + s * stride
        near = face + s * face_stride
        if s == number:
            dn[last] -= over * wall_force(last_h, last_u, gravity[last])
            break
        thick, surface, u, t = h[cell], h[cell] + bed[cell], un[cell], ut[cell]
        slope_h = slope_e = slope_u = slope_t = 0.0
        below, above = cell - stride, cell + stride
        if (
            0 < s < number - 1
            and thick > DRY
            and (frozen[near] == 0 or frozen[near + face_stride] == 0)
            and abs(bed[cell] - bed[below]) <= jump
            and abs(bed[above] - bed[cell]) <= jump
        ):
            slope_h = 0.5 * limited(thick - h[below], h[above] - thick)
            slope_e = 0.5 * limited(surface - h[below] - bed[below], h[above] + bed[above] - surface)
            # A dry cell has no velocity: beside it the slope is the other side's, or the tip would lag behind. It
            # stays no faster than a wave can make it: speed + 2 √(g h) does not grow outwards.
            dry_below, dry_above = h[below] <= DRY, h[above] <= DRY
            if not (dry_below and dry_above):
                low = above if dry_below else cell
                up = below if dry_above else cell
                slope_u = 0.5 * limited(un[low] - un[low - stride], un[up + stride] - un[up])
                slope_t = 0.5 * limited(ut[low] - ut[low - stride], ut[up + stride] - ut[up])
            if dry_below != dry_above:
                inner, outwards = (above, -1.0) if dry_below else (below, 1.0)
                waves = 2.0 * (math.sqrt(gravity[inner] * h[inner]) - math.sqrt(gravity[cell] * thick))
                slope_u = min(slope_u, max(outwards * (un[inner] - u) + waves, 0.0))
        h_low, h_up = thick - slope_h, thick + slope_h
        e_low, e_up = surface - slope_e, surface + slope_e
        part_low = h_up / thick if thick > DRY else 0.0
        part_up = h_low / thick if thick > DRY else 0.0
        u_low, u_up = u - part_low * slope_u, u + part_up * slope_u
        t_low, t_up = t - part_low * slope_t, t + part_up * slope_t
        own = gravity[cell]
        dn[cell] -= over * own * thick * ((e_up - h_up) - (e_low - h_low))
        if s == 0:
            dn[cell] += over * wall_force(h_low, -u_low, own)
        elif frozen[near] == 1:
            dn[last] -= over * gravity[last] * 0.5 * last_h * last_h
            dn[cell] += over * own * 0.5 * h_low * h_low
        elif is_wall(h[last], bed[last], thick, bed[cell], jump):
            dn[last] -= over * wall_force(last_h, last_u, gravity[last])
        elif is_wall(thick, bed[cell], h[last], bed[last], jump):
            dn[cell] += over * wall_force(h_low, -u_low, own)
        else:
            floor = max(last_e - last_h, e_low - h_low)
            cut_last, cut = max(last_e - floor, 0.0), max(e_low - floor, 0.0)
            if len(curve) > 0 and abs(bed[cell] - bed[last]) <= jump:
                drop, tooth = h[last] + bed[last] - surface, curve[last, 5] + curve[cell, 5]
                cut_last = min(cut_last + min(max(drop, 0.0), tooth), last_h)
                cut = min(cut + min(max(-drop, 0.0), tooth), h_low)
            mass, momentum, pressure = hll(cut_last, last_u, gravity[last], cut, u_low, own)
            across = mass * (last_t if mass > 0.0 else t_low)
            push_last = momentum + gravity[last] * (pressure + 0.5 * (last_h * last_h - cut_last * cut_last))
            push = momentum + own * (pressure + 0.5 * (h_low * h_low - cut * cut))
            dh[last] -= over * mass
            dh[cell] += over * mass
            dn[last] -= over * push_last
            dn[cell] += over * push
            dt[last] -= over * across
            dt[cell] += over * across
        last, last_h, last_e, last_u, last_t = cell, h_up, e_up, u_up, t_up
