"""Walls at one grid node: no motion through a face, and stick, slip or Coulomb friction along it.

A node of a face is held only as far as the material really is at the wall: the nearest point may come down to half a
spacing (its own radius) within the step. Without that, material would stop up to a cell and a half before the wall,
where the shape functions of its first points begin, and heaps that fell would float above the floor.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from collections.abc import Callable

from gns_pl.mpm.compiled import compiled
from gns_pl.scene import Wall

STICK = -1.0
"""Marks a sticking face in the table of friction coefficients; 0 is slip."""

NUMBERS: dict[str, Callable[[float], float]] = {
    "stick": lambda coefficient: STICK,
    "slip": lambda coefficient: 0.0,
    "friction": lambda coefficient: coefficient,
}
"""Condition of a wall → the one number by which kernels know its law and coefficient: Coulomb's coefficient if it is at
least 0, another law if it is negative."""


def wall_number(wall: Wall) -> float:
    """Return the number of a wall in the table of friction coefficients."""
    return NUMBERS[wall.condition](wall.friction)


STICK_REACH = 0.1
"""A sticking face holds material whose nearest point has moved off by up to this part of its radius: stretched a
little, not yet torn off."""


@compiled
def clearance(distance, radius, friction):
    """Return how far the material may still move towards a face, in the unit of the lengths given.

    Args:
        distance: of the nearest point from the wall, at least 0.
        radius: half the spacing of the points.
        friction: coefficient of the face, or `STICK`.
    """
    gap = distance - radius
    if gap <= (STICK_REACH * radius if friction == STICK else 0.0):
        return 0.0
    return gap


@compiled
def normal_velocity(outward, limit, friction):
    """Return the outward velocity that a face leaves to its node [m/s].

    Args:
        outward: velocity towards the wall [m/s]; negative if the material leaves.
        limit: gap between the nearest point and the wall over the time step [m/s].
        friction: coefficient of the face, or `STICK`.
    """
    if outward > limit:
        return limit
    if friction == STICK and limit <= 0.0:
        return 0.0  # a sticking face does not let go
    return outward


@compiled
def slip_factor(impulse, speed, friction):
    """Return the factor in [0, 1] by which a face slows the motion along it.

    Coulomb: the tangential change of velocity is at most friction · normal change.

    Args:
        impulse: change of the normal velocity made by the face, ≥ 0 [m/s].
        speed: tangential speed before [m/s].
        friction: coefficient of the face, or `STICK`.
    """
    if friction == STICK:
        return 0.0
    taken = friction * impulse
    return 1.0 - taken / speed if taken < speed else 0.0


@compiled
def hold_at_walls(vx, vy, vz, lx, ly, lz, sx, sy, sz, mx, my, mz):
    """Return the velocity of a node after the faces it lies on, one per axis at most [m/s].

    All faces first stop the motion through them, then each slows the motion along it.

    Args:
        vx, vy, vz: velocity before [m/s].
        lx, ly, lz: per axis, gap over time step [m/s].
        sx, sy, sz: per axis, −1 at the lower face, +1 at the upper, 0 if the node lies on neither.
        mx, my, mz: per axis, friction coefficient of that face, or `STICK`.
    """
    ix = iy = iz = 0.0
    tx = ty = tz = False
    if sx != 0.0:
        new = sx * normal_velocity(sx * vx, lx, mx)
        ix, tx, vx = abs(vx - new), lx <= 0.0, new
    if sy != 0.0:
        new = sy * normal_velocity(sy * vy, ly, my)
        iy, ty, vy = abs(vy - new), ly <= 0.0, new
    if sz != 0.0:
        new = sz * normal_velocity(sz * vz, lz, mz)
        iz, tz, vz = abs(vz - new), lz <= 0.0, new
    if sx != 0.0 and (ix > 0.0 or (tx and mx == STICK)):
        factor = slip_factor(ix, math.hypot(vy, vz), mx)
        vy, vz = factor * vy, factor * vz
    if sy != 0.0 and (iy > 0.0 or (ty and my == STICK)):
        factor = slip_factor(iy, math.hypot(vz, vx), my)
        vz, vx = factor * vz, factor * vx
    if sz != 0.0 and (iz > 0.0 or (tz and mz == STICK)):
        factor = slip_factor(iz, math.hypot(vx, vy), mz)
        vx, vy = factor * vx, factor * vy
    return vx, vy, vz
