"""From bodies to particles: a lattice in every body, optionally jittered, carved by the obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES, ParticleType
from gns_pl.scene.boundaries import signed_distance
from gns_pl.scene.definition import Scene
from gns_pl.scene.origin import check_coarseness
from gns_pl.scene.release import Release

MAX_PARTICLES = 20_000_000
"""More than this is taken for a mistyped spacing."""


@dataclass(frozen=True)
class Particles:
    """The particles of a scene at time zero.

    Attributes:
        position: [N, D] [m].
        velocity: [N, D] [m/s].
        mass: [N] [kg]; per metre of depth in two dimensions.
        volume: [N] [m³] (m² in two dimensions).
        material: [N, K], the features of `fields.MATERIAL_FEATURES`.
        material_name: [N] indices into `tuple(scene.materials)`.
        particle_type: [N] `ParticleType`.
        body: [N] indices into `scene.bodies`.
        lattice: [N, D] place in the body's lattice, from 0 along every axis.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    mass: NDArray[np.float64]
    volume: NDArray[np.float64]
    material: NDArray[np.float32]
    material_name: NDArray[np.int64]
    particle_type: NDArray[np.int64]
    body: NDArray[np.int64]
    lattice: NDArray[np.int64]


def fill_scene(
    scene: Scene, spacing: float, *, jitter: float = 0.0, generator: np.random.Generator | None = None
) -> Particles:
    """Fill every body with a lattice whose spacing comes as near to `spacing` as the body's size allows.

    Each body is split into `round(size / spacing)` equal cells per axis (at least one) with a particle in the middle
    of each, so that the particles' volumes add up to the body's exactly, whatever its size. Particles that would start
    inside an obstacle or the ground are left out; this changes none of the others. A release is filled in columns from
    the ground up (`Release.columns`).

    Args:
        scene: what to fill.
        spacing: wanted distance of neighbouring particles [m].
        jitter: largest random offset along each axis, in halves of the lattice spacing.
        generator: source of the offsets; needed if `jitter` is not 0.

    Raises:
        InputError: a spacing that is not positive, a jitter outside [0, 1), more than `MAX_PARTICLES` particles, or a
            body of which the obstacles leave nothing, or a box so far from zero that float32 cannot hold its particles.
    """
    if not spacing > 0 or not np.isfinite(spacing):
        raise InputError(f"the particle spacing must be positive, not {spacing}.")
    if not 0 <= jitter < 1:
        raise InputError(f"the jitter must lie in [0, 1), not {jitter}.")
    if jitter and generator is None:
        raise InputError("a jitter needs a random generator.")
    extent = max(map(abs, (*scene.lower, *scene.upper)))
    check_coarseness(f"scene {scene.name!r}", extent, spacing, "move it near zero: gns_pl.scene.near_origin(scene)")
    counts = [[max(1, round(size / spacing)) for size in body.size] for body in scene.bodies]
    total = sum(
        round(body.volume / spacing**3) if isinstance(body, Release) else int(np.prod(count, dtype=np.float64))
        for body, count in zip(scene.bodies, counts, strict=True)
    )
    if total > MAX_PARTICLES:
        raise InputError(
            f"scene {scene.name!r} at a spacing of {spacing:g} m would have {total} particles; choose a larger spacing."
        )

    def drawn(number: int) -> NDArray[np.float64] | float:
        """Offsets of particles from their places in a lattice [N, D], in its cells."""
        if not jitter or generator is None:
            return 0.0
        return 0.5 * jitter * generator.uniform(-1, 1, (number, scene.dim))

    lattices, positions, volumes = [], [], []
    for index, (body, count) in enumerate(zip(scene.bodies, counts, strict=True)):
        if isinstance(body, Release) and scene.terrain is not None:
            position, volume, lattice = body.columns(spacing, scene.terrain.height, drawn)
        else:
            cell = np.array(body.size) / np.array(count)
            lattice = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, scene.dim)
            position = np.array(body.position) + (lattice + 0.5 + drawn(len(lattice))) * cell
            volume = np.full(len(lattice), float(np.prod(cell)))
        free = _outside_obstacles(scene, position)
        if not free.any():
            what = "obstacles leave" if scene.terrain is None else "ground and obstacles leave"
            raise InputError(
                f"scene {scene.name!r}, body {index}: {what} nothing of it at a spacing of {spacing:g} m; "
                "move it, or choose a smaller spacing."
            )
        lattices.append(lattice[free])
        positions.append(position[free])
        volumes.append(volume[free])
    body_index = np.repeat(np.arange(len(scene.bodies)), [len(position) for position in positions])
    names, materials = list(scene.materials), [scene.materials[body.material] for body in scene.bodies]
    features = [[getattr(material, name) for name in MATERIAL_FEATURES] for material in materials]
    volume = np.concatenate(volumes)
    return Particles(
        position=np.concatenate(positions),
        velocity=np.array([body.velocity for body in scene.bodies])[body_index],
        mass=volume * np.array([material.density for material in materials])[body_index],
        volume=volume,
        material=np.array(features, dtype=np.float32)[body_index],
        material_name=np.array([names.index(body.material) for body in scene.bodies])[body_index],
        particle_type=np.full(len(body_index), int(ParticleType.SAND), dtype=np.int64),
        body=body_index,
        lattice=np.concatenate(lattices),
    )


def _outside_obstacles(scene: Scene, position: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of the positions [N, D] [m] lie in no obstacle and not in the ground [N]."""
    free = np.ones(len(position), dtype=bool)
    if scene.terrain is not None:
        free &= position[:, -1] >= scene.terrain.height(position[:, :-1])
    for obstacle in scene.obstacles:
        free &= signed_distance(obstacle, position)[0] >= 0
    return free
