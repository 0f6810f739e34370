"""What a few frames tell about a data set: spacing, neighbours, gravity, impacts. Pure functions of arrays.

No file is read here, and nothing is compared with a setting; `survey` collects the frames, `training.advice` draws
the conclusions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_FLIGHT_TOLERANCE = 0.01
"""Relative change of an acceleration from one step to the next that still counts as none."""

_PEAK_WIDTH, _PEAK_SHARE = 0.02, 0.3
"""Free fall shows as one value that this share of the steady accelerations has within this relative width."""

_LEAST_FALLING = 30
"""Fewer particles in steady fall than this tell nothing."""


def nearest_distance(position: NDArray[np.floating], queries: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the distance from some particles to their nearest neighbour [Q] [m]; infinite where there is none.

    Args:
        position: [N, D] [m].
        queries: [Q] indices of the particles that are asked.
    """
    distance, _ = cKDTree(position).query(position[queries], k=2)
    return np.asarray(distance[:, 1])


def neighbour_counts(
    position: NDArray[np.floating], radii: NDArray[np.floating], queries: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return how many other particles are within each radius [Q, M].

    Args:
        position: [N, D] [m].
        radii: [M] [m].
        queries: [Q] indices of the particles that are asked.
    """
    tree = cKDTree(position)
    # Numbers alone, not the pairs: with wrong units everything may be within the radius.
    counts = [tree.query_ball_point(position[queries], radius, return_length=True) - 1 for radius in radii]
    return np.stack(counts, axis=1).astype(np.int64)


def interior_spacing(
    position: NDArray[np.floating],
    lower: NDArray[np.floating],
    upper: NDArray[np.floating],
    queries: NDArray[np.int64],
    *,
    margin: float,
) -> float:
    """Return the edge of the cube that one particle has to itself inside the material [m]; NaN with too few of them.

    The ball around a particle that holds as many particles as a block of three on each side has that block's volume.
    Near a surface the ball is half empty, so the best surrounded fifth of the particles speaks for the inside; walls
    are mirrors, so that a heap a few particles thick has an inside as well. Jitter moves this by a few per cent, while
    it shortens the distance to the nearest neighbour by a third.

    Args:
        position: [N, D] [m].
        lower: lower corner of the box [D] [m].
        upper: upper corner of the box [D] [m].
        queries: [Q] indices of the particles that are asked.
        margin: particles closer to a wall than this are mirrored in it [m].
    """
    number, dim = position.shape
    block = 3**dim
    if number < block + 1:
        return math.nan
    seen = position.astype(np.float64)
    for axis in range(dim):
        for wall in (lower[axis], upper[axis]):
            image = seen[np.abs(seen[:, axis] - wall) < margin]
            image[:, axis] = 2 * wall - image[:, axis]
            seen = np.concatenate([seen, image])
    distance, _ = cKDTree(seen).query(position[queries].astype(np.float64), k=[block, block + 1])
    radius = distance.mean(axis=1)  # between the last particle of the block and the first one outside
    ball = math.pi ** (dim / 2) / math.gamma(dim / 2 + 1)
    return float(np.percentile(radius, 20) * (ball / block) ** (1 / dim))


def measure_gravity(
    acceleration: NDArray[np.floating], previous: NDArray[np.floating], rounding: float
) -> tuple[float, NDArray[np.bool_]]:
    """Return the magnitude of gravity as free fall shows it [m/s²], and which particles fall freely [M].

    Gravity is not assumed: free fall is the acceleration along the last axis that stays the same for two steps and
    that many particles share to within 2 %. NaN if no such value stands out, as where nothing leaves the ground.

    Args:
        acceleration: second differences of positions [M, D] [m/s²].
        previous: the same one step earlier [M, D] [m/s²].
        rounding: size of an acceleration that is nothing but rounding of positions [m/s²].
    """
    size = np.linalg.norm(acceleration, axis=1)
    allowed = _FLIGHT_TOLERANCE * size + 4 * rounding
    steady = np.abs(acceleration - previous).max(axis=1) < allowed
    plumb = np.abs(acceleration[:, :-1]).max(axis=1) < allowed
    down = np.flatnonzero(steady & plumb & (acceleration[:, -1] < 0) & (size > 20 * rounding))
    none = np.zeros(len(size), dtype=bool)
    if len(down) < _LEAST_FALLING:
        return math.nan, none
    fall = np.sort(-acceleration[down, -1])
    # The densest interval of the chosen relative width.
    ends = np.searchsorted(fall, fall * (1 + _PEAK_WIDTH), side="right")
    start = int(np.argmax(ends - np.arange(len(fall))))
    peak = fall[start : ends[start]]
    if len(peak) < max(_LEAST_FALLING, _PEAK_SHARE * len(fall)):
        return math.nan, none
    gravity = float(np.median(peak))
    near = down[np.abs(-acceleration[down, -1] - gravity) < 2 * _PEAK_WIDTH * gravity]
    none[near] = True
    return gravity, none


def top_share(squares: NDArray[np.floating], share: float) -> float:
    """Return which part of a sum the largest entries hold; NaN if the sum is zero.

    Args:
        squares: [M], none negative.
        share: of the entries, at least one of them.
    """
    total = float(squares.sum(dtype=np.float64))
    if total == 0:
        return math.nan
    number = max(1, round(share * len(squares)))
    return float(np.partition(squares, len(squares) - number)[-number:].sum(dtype=np.float64)) / total
