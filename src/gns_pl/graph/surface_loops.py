"""What is rigid around particles on a CPU: what `graph.surfaces` says, a particle a time.

Some sixty small torch operations on a few hundred particles took a third of a step.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.machine import compile_function

FLATTEST = 0.25
"""A plane counts as ground below a particle where the vertical part of its normal is larger than this."""

DEEPEST = 1.5
"""The weight of a surface of which a particle is inside ends here."""


@compile_function
def distance_of_plane(place: Any, normal: Any, offset: Any) -> Any:
    """Return the distance of a place [D] from a plane [m]."""
    along = np.float32(0)
    for axis in range(len(place)):
        along += place[axis] * normal[axis]
    return along - offset


@compile_function
def distance_of_cuboid(place: Any, lower: Any, upper: Any, normal: Any) -> Any:
    """Return the distance of a place [D] from a cuboid [m], and fill in the normal [D], inside the nearest face's."""
    dim, square, nearest = len(place), np.float32(0), 0
    most = np.float32(-np.inf)
    for axis in range(dim):
        below, above = lower[axis] - place[axis], place[axis] - upper[axis]
        beyond = max(below, above)
        if beyond > most:
            most, nearest = beyond, axis
        outside = max(beyond, np.float32(0))
        normal[axis] = -outside if below > above else outside
        square += outside * outside
    if square > 0:
        distance = np.sqrt(square)
        for axis in range(dim):
            normal[axis] /= distance
        return distance
    normal[:] = 0
    normal[nearest] = -1 if lower[nearest] - place[nearest] > place[nearest] - upper[nearest] else 1
    return most


@compile_function
def fill_spline(place: Any, corner: Any, cell: Any, count: Any, weight: Any, slope: Any) -> Any:
    """Fill in the quadratic B-splines of an axis at a place and their slopes [3]; return the first, what is beyond."""
    half = np.float32(0.5)
    along = (place - corner) / cell
    base = np.float32(0)
    if along > half:  # NaN, of a run that broke, is no place in the table
        base = min(np.floor(along - half), np.float32(count - 3))
    part = along - base - np.float32(1)
    inside = min(max(part, -half), half)
    low, high = half - inside, half + inside
    weight[0], weight[1], weight[2] = half * low * low, np.float32(0.75) - inside * inside, half * high * high
    slope[0], slope[1], slope[2] = -low, np.float32(-2) * inside, high
    return np.int64(base), part - inside


@compile_function
def distance_of_ground(
    place: Any, heights: Any, first: Any, shape: Any, corner: Any, cell: Any, work: Any, up: Any
) -> Any:
    """Return the height of a ground [m] and the distance of a place [D] from its tangent plane [m]; fill in its normal.

    Args:
        place: [D] [m].
        heights, first, shape, corner, cell: of the scene, as in `Surfaces`.
        work: room for splines and slopes [4, 3].
        up: the normal [D].
    """
    axes = len(place) - 1
    base_x, far_x = fill_spline(place[0], corner[0], cell, shape[0], work[0], work[1])
    height, rise_x, rise_y, far_y = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    if axes == 1:
        for i in range(3):
            value = heights[first + base_x + i]
            height += work[0, i] * value
            rise_x += work[1, i] * value
    else:
        base_y, far_y = fill_spline(place[1], corner[1], cell, shape[1], work[2], work[3])
        for i in range(3):
            row, row_rise = np.float32(0), np.float32(0)
            node = first + (base_x + i) * shape[1] + base_y
            for j in range(3):
                value = heights[node + j]
                row += work[2, j] * value
                row_rise += work[3, j] * value
            height += work[0, i] * row
            rise_x += work[1, i] * row
            rise_y += work[0, i] * row_rise
    height += far_x * rise_x + far_y * rise_y
    up[0], up[axes] = -rise_x / cell, 1
    length = up[0] * up[0] + np.float32(1)
    if axes == 2:
        up[1] = -rise_y / cell
        length += up[1] * up[1]
    length = np.sqrt(length)
    for axis in range(axes + 1):
        up[axis] /= length
    return height, (place[axes] - height) * up[axes]


@compile_function
def surface(
    s: int, place: Any, b: Any, planes: Any, offset: Any, plane_grip: Any, lower: Any, upper: Any, cuboid_grip: Any,
    heights: Any, first: Any, shape: Any, corner: Any, cell: Any, ground_grip: Any, work: Any, normal: Any,
) -> Any:  # fmt: skip
    """Return distance [m] and grip of a surface, and its height [m] where it is below; fill in its normal.

    Args:
        s: its number: planes, then cuboids, then the ground.
        place: [D] [m].
        b: scene of the particle.
        planes, offset, plane_grip, lower, upper, cuboid_grip: as in `Surfaces`, `planes` being its `normal`.
        heights, first, shape, corner, cell, ground_grip: likewise.
        work: room of `distance_of_ground`.
        normal: of the surface [D].
    """
    top, below = len(place) - 1, np.float32(-np.inf)
    if s < planes.shape[1]:
        normal[:] = planes[b, s]
        distance = distance_of_plane(place, normal, offset[b, s])
        if normal[top] > FLATTEST:
            below = place[top] - distance / normal[top]
        return distance, plane_grip[b, s], below
    c = s - planes.shape[1]
    if c < lower.shape[1]:
        over = place[top] >= upper[b, c, top]
        for axis in range(top):
            over = over and lower[b, c, axis] <= place[axis] <= upper[b, c, axis]
        if over:
            below = upper[b, c, top]
        return distance_of_cuboid(place, lower[b, c], upper[b, c], normal), cuboid_grip[b, c], below
    below, distance = distance_of_ground(place, heights, first[b], shape[b], corner[b], cell[b], work, normal)
    return distance, ground_grip[b], below


@compile_function
def see(
    place: Any, batch: Any, radius: Any, planes: Any, offset: Any, plane_grip: Any, lower: Any, upper: Any,
    cuboid_grip: Any, heights: Any, first: Any, shape: Any, corner: Any, cell: Any, ground_grip: Any,
) -> Any:  # fmt: skip
    """Return `SurfaceFields` of particles: approach and grip [N, 2, D], and the height below [N].

    Args:
        place: [N, D] [m].
        batch: scene of every particle [N].
        radius: R [m].
        planes, offset, plane_grip, lower, upper, cuboid_grip: as of `surface`.
        heights, first, shape, corner, cell, ground_grip: likewise.
    """
    number, dim = place.shape
    seen, below = np.zeros((number, 2, dim), np.float32), np.full(number, -np.inf, np.float32)
    normal, work = np.zeros(dim, np.float32), np.zeros((4, 3), np.float32)
    for i in range(number):
        for s in range(planes.shape[1] + lower.shape[1] + 1):
            distance, grip, height = surface(
                s, place[i], batch[i], planes, offset, plane_grip, lower, upper, cuboid_grip,
                heights, first, shape, corner, cell, ground_grip, work, normal,
            )  # fmt: skip
            below[i] = max(below[i], height)
            weight = min(max(np.float32(1) - distance / radius, np.float32(0)), np.float32(DEEPEST))
            for axis in range(dim):
                seen[i, 0, axis] += weight * normal[axis]
                seen[i, 1, axis] += weight * grip * normal[axis]
    return seen, below


@compile_function
def normals_of(
    place: Any, batch: Any, planes: Any, offset: Any, plane_grip: Any, lower: Any, upper: Any,
    cuboid_grip: Any, heights: Any, first: Any, shape: Any, corner: Any, cell: Any, ground_grip: Any,
) -> Any:  # fmt: skip
    """Return the normals of all surfaces at places [N, S, D]; arguments as of `see`."""
    number, dim = place.shape
    surfaces = planes.shape[1] + lower.shape[1] + 1
    normal, work = np.zeros((number, surfaces, dim), np.float32), np.zeros((4, 3), np.float32)
    for i in range(number):
        for s in range(surfaces):
            surface(
                s, place[i], batch[i], planes, offset, plane_grip, lower, upper, cuboid_grip,
                heights, first, shape, corner, cell, ground_grip, work, normal[i, s],
            )  # fmt: skip
    return normal


@compile_function
def push_out(
    place: Any, batch: Any, planes: Any, offset: Any, lower: Any, upper: Any,
    heights: Any, first: Any, shape: Any, corner: Any, cell: Any,
) -> None:  # fmt: skip
    """Put places [N, D] that are inside something rigid onto its surface, where they stand; arguments as of `see`."""
    number, dim = place.shape
    normal, work, push = np.zeros(dim, np.float32), np.zeros((4, 3), np.float32), np.zeros(dim, np.float32)
    for i in range(number):
        b = batch[i]
        push[:] = 0
        for s in range(planes.shape[1]):
            distance = distance_of_plane(place[i], planes[b, s], offset[b, s])
            if distance < 0:
                push -= distance * planes[b, s]
        place[i] += push
        push[:] = 0
        for c in range(lower.shape[1]):
            distance = distance_of_cuboid(place[i], lower[b, c], upper[b, c], normal)
            if distance < 0:
                push -= distance * normal
        place[i] += push
        _, distance = distance_of_ground(place[i], heights, first[b], shape[b], corner[b], cell[b], work, normal)
        if distance < 0:
            place[i] -= distance * normal
