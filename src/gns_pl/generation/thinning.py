"""Every k-th lattice point of a trajectory: a fine simulation at the spacing at which one trains."""

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
        owner = f"scene {scene.name!r}, body {index}"
        inside = np.flatnonzero(particles.body == index)
        place = particles.lattice[inside]
        place = place - place.min(axis=0)  # an obstacle may have taken the first layers
        count = place.max(axis=0) + 1
        if (count < every).all():
            places = " x ".join(map(str, count))
            raise InputError(f"{owner}: has {places} lattice places, too few to keep every {every}; choose less.")
        chosen = inside[(place % every == np.array(offset) % np.minimum(every, count)).all(axis=1)]
        if len(chosen) == 0:
            raise InputError(f"{owner}: obstacles leave nothing of every {every}; choose less.")
        keep[chosen] = True
    return np.flatnonzero(keep)


def thin_trajectory(
    trajectory: Trajectory, mpm: Mapping[str, Any], seed: int, every: int, offset: Sequence[int]
) -> Trajectory:
    """Return every k-th point per direction of a trajectory of the material point method, as `kept_points` chooses.

    What is kept of a body weighs what the body weighs, so that runout, heights and energies compare with the whole.

    Args:
        trajectory: of all points, in the solver's order.
        mpm: settings of the solver that made it.
        seed: of the random placement it started from.
        every: k; 1 gives the trajectory back.
        offset: of the lattice that is kept, from 0 to k − 1 along each axis [D].

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
    keep = kept_points(scene, particles, every, offset)
    body, kept_body = particles.body, particles.body[keep]
    mass = trajectory.mass.astype(np.float64)
    growth = np.bincount(body, weights=mass) / np.bincount(kept_body, weights=mass[keep])
    return replace(
        trajectory,
        position=trajectory.position[:, keep],
        particle_type=trajectory.particle_type[keep],
        material=trajectory.material[keep],
        mass=(mass[keep] * growth[kept_body]).astype(np.float32),
        initial_velocity=trajectory.initial_velocity[keep],
        provenance={**trajectory.provenance, "every": every, "offset": list(offset)},
    )


def stored_counts(scene: Scene, spacing: float, offsets: Mapping[int, Sequence[int]]) -> tuple[int, dict[int, int]]:
    """Return how many points simulate `scene`, and k → how many of them are stored.

    Args:
        scene: what to simulate.
        spacing: of the solver's points [m].
        offsets: k → offset along each axis.

    Raises:
        InputError: a lattice too small for a k.
    """
    particles = fill_scene(scene, spacing)
    counts = {every: len(kept_points(scene, particles, every, offset)) for every, offset in offsets.items()}
    return len(particles.position), counts
