"""One of k^D points of a trajectory: a fine simulation at the spacing at which one trains.

Either every k-th lattice point is kept, or one point drawn in each block of k^D. What runs farthest starts in the
outermost layer; a lattice holds that layer or does not, drawn points hold their share of it (docs/data.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.mpm import settings as solver
from gns_pl.scene import Particles, Scene, fill_scene
from gns_pl.trajectory import Trajectory

Offset = Sequence[int] | None
"""Of the lattice that is kept, from 0 to k − 1 along each axis [D]; None where a point is drawn in each block."""


def kept_points(scene: Scene, particles: Particles, every: int, offset: Sequence[int]) -> NDArray[np.int64]:
    """Return the indices of the particles at every k-th lattice place of their body, counted from `offset` [M].

    Along an axis where a body has fewer than k places, the offset is taken modulo their number, so that a thin layer
    keeps one of its layers.

    Args:
        scene: what was filled, for messages.
        particles: its filling.
        every: k.
        offset: from 0 to k − 1 along each axis [D].

    Raises:
        InputError: a body that has fewer than k places along every axis, or of which nothing would be kept.
    """
    if every == 1:
        return np.arange(len(particles.lattice))
    keep = np.zeros(len(particles.lattice), dtype=bool)
    for index in range(len(scene.bodies)):
        inside, place, count = _places(scene, particles, index, every)
        chosen = inside[(place % every == np.array(offset) % np.minimum(every, count)).all(axis=1)]
        if len(chosen) == 0:
            raise InputError(
                f"scene {scene.name!r}, body {index}: obstacles leave nothing of every {every}; choose less."
            )
        keep[chosen] = True
    return np.flatnonzero(keep)


def drawn_points(
    scene: Scene, particles: Particles, every: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of one particle drawn in each block of k^D lattice places [M], and the block of all [N].

    Along an axis a body of n places has round(n / k) blocks, one at least, as equal as whole places allow. Every place
    of a block is equally likely; of the blocks that lie side by side equally many, to one, take each of their layers,
    as in a Latin square, which leaves less to chance than draws of each block for itself.

    Args:
        scene: what was filled, for messages.
        particles: its filling.
        every: k.
        seed: of the draws.

    Returns:
        The indices, rising, and numbers of blocks.

    Raises:
        InputError: a body that has fewer than k places along every axis.
    """
    generator = np.random.default_rng([seed, every])
    chosen, block_of, blocks = [], np.zeros(len(particles.lattice), dtype=np.int64), 0
    for index in range(len(scene.bodies)):
        inside, place, count = _places(scene, particles, index, every)
        number = np.maximum(1, np.rint(count / every).astype(np.int64))
        block = np.ravel_multi_index(tuple((place * number // count).T), tuple(number))
        drawn = _drawn_places(number, count, generator)[block]
        # First the drawn place of a block; where an obstacle has taken it, any other.
        order = np.lexsort((generator.random(len(inside)), (place != drawn).any(axis=1), block))
        _, first = np.unique(block[order], return_index=True)
        chosen.append(inside[order[first]])
        block_of[inside] = block + blocks
        blocks += int(number.prod())
    return np.sort(np.concatenate(chosen)), block_of


def _places(
    scene: Scene, particles: Particles, index: int, every: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the particles of a body [N], their places in its lattice from 0 on [N, D], and how many there are [D]."""
    inside = np.flatnonzero(particles.body == index)
    place = particles.lattice[inside]
    place = place - place.min(axis=0)  # an obstacle may have taken the first layers
    count = place.max(axis=0) + 1
    if (count < every).all():
        owner, places = f"scene {scene.name!r}, body {index}", " x ".join(map(str, count))
        raise InputError(f"{owner}: has {places} lattice places, too few to keep every {every}; choose less.")
    return inside, place, count


def _drawn_places(
    number: NDArray[np.int64], count: NDArray[np.int64], generator: np.random.Generator
) -> NDArray[np.int64]:
    """Return a place of the lattice for every block of a body [blocks, D].

    Args:
        number: of blocks along each axis [D].
        count: of places along each axis [D].
        generator: of the draws.
    """
    grid = np.indices(number.tolist()).reshape(len(number), -1)
    drawn = np.empty_like(grid)
    for axis, (blocks, places) in enumerate(zip(number, count, strict=True)):
        first = -(-np.arange(blocks + 1) * places // blocks)  # ceil: the least place p with p · blocks // places = row
        for row in range(blocks):
            beside = np.flatnonzero(grid[axis] == row)
            layers = first[row + 1] - first[row]
            dealt = (np.arange(len(beside)) + generator.integers(layers)) % layers
            drawn[axis, beside] = first[row] + generator.permutation(dealt)
    return np.asarray(drawn.T)


def thin_trajectory(
    trajectory: Trajectory, mpm: Mapping[str, Any], seed: int, every: int, offset: Offset
) -> Trajectory:
    """Return one of k^D points of a trajectory of the material point method, of a lattice or drawn.

    What is kept of a body weighs what the body weighs, so that runout, heights and energies compare with the whole; a
    drawn point weighs what its block does.

    Args:
        trajectory: of all points, in the solver's order.
        mpm: settings of the solver that made it.
        seed: of the random placement it started from; points are drawn by it too.
        every: k; 1 gives the trajectory back.
        offset: of the lattice that is kept (`kept_points`), or None (`drawn_points`).

    Raises:
        InputError: a lattice too small for k.
        ValueError: not a trajectory of these settings and this seed.
    """
    if every == 1:
        return trajectory
    scene, start = trajectory.scene, trajectory.position[0]
    particles, spacing = solver.place_points(scene, mpm, seed), solver.solver_config(mpm).spacing
    if start.shape != particles.position.shape or np.abs(start - particles.position).max() > 0.01 * spacing:
        raise ValueError(f"scene {scene.name!r}: its first frame is not what these settings and this seed place")
    if offset is None:
        keep, group = drawn_points(scene, particles, every, seed)
    else:
        keep, group = kept_points(scene, particles, every, offset), particles.body
    mass = trajectory.mass.astype(np.float64)
    growth = np.bincount(group, weights=mass)[group[keep]] / np.bincount(group[keep], weights=mass[keep])[group[keep]]
    how = {"sampling": "stratified"} if offset is None else {"offset": list(offset)}
    return replace(
        trajectory,
        position=trajectory.position[:, keep],
        particle_type=trajectory.particle_type[keep],
        material=trajectory.material[keep],
        mass=(mass[keep] * growth).astype(np.float32),
        initial_velocity=trajectory.initial_velocity[keep],
        provenance={**trajectory.provenance, "every": every, **how},
    )


def stored_counts(scene: Scene, spacing: float, offsets: Mapping[int, Offset]) -> tuple[int, dict[int, int]]:
    """Return how many points simulate `scene`, and k → how many of them are stored.

    Args:
        scene: what to simulate.
        spacing: of the solver's points [m].
        offsets: k → offset along each axis, or None.

    Raises:
        InputError: a lattice too small for a k.
    """
    particles = fill_scene(scene, spacing)
    kept = {
        every: drawn_points(scene, particles, every, 0)[0]
        if offset is None
        else kept_points(scene, particles, every, offset)
        for every, offset in offsets.items()
    }
    return len(particles.position), {every: len(points) for every, points in kept.items()}
