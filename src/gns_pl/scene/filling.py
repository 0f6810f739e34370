"""From bodies to particles: a lattice in every body, optionally jittered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES, ParticleType
from gns_pl.scene.definition import Scene

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
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    mass: NDArray[np.float64]
    volume: NDArray[np.float64]
    material: NDArray[np.float32]
    material_name: NDArray[np.int64]
    particle_type: NDArray[np.int64]


def fill_scene(
    scene: Scene, spacing: float, *, jitter: float = 0.0, generator: np.random.Generator | None = None
) -> Particles:
    """Fill every body with a lattice whose spacing comes as near to `spacing` as the body's size allows.

    Each body is split into `round(size / spacing)` equal cells per axis (at least one) with a particle in the middle
    of each, so that the particles' volumes add up to the body's exactly, whatever its size.

    Args:
        scene: what to fill.
        spacing: wanted distance of neighbouring particles [m].
        jitter: largest random offset along each axis, in halves of the lattice spacing.
        generator: source of the offsets; needed if `jitter` is not 0.

    Raises:
        InputError: a spacing that is not positive, a jitter outside [0, 1), or more than `MAX_PARTICLES` particles.
    """
    if not spacing > 0 or not np.isfinite(spacing):
        raise InputError(f"the particle spacing must be positive, not {spacing}.")
    if not 0 <= jitter < 1:
        raise InputError(f"the jitter must lie in [0, 1), not {jitter}.")
    if jitter and generator is None:
        raise InputError("a jitter needs a random generator.")
    names = list(scene.materials)
    counts = [[max(1, round(size / spacing)) for size in body.size] for body in scene.bodies]
    total = sum(int(np.prod(count, dtype=np.float64)) for count in counts)
    if total > MAX_PARTICLES:
        raise InputError(
            f"scene {scene.name!r} at a spacing of {spacing:g} m would have {total} particles; choose a larger spacing."
        )
    parts = []
    for body, count in zip(scene.bodies, counts, strict=True):
        cell = np.array(body.size) / np.array(count)
        axes = [np.arange(n) + 0.5 for n in count]
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, scene.dim)
        if jitter and generator is not None:
            lattice = lattice + 0.5 * jitter * generator.uniform(-1, 1, lattice.shape)
        parts.append((np.array(body.position) + lattice * cell, float(np.prod(cell))))
    number = [len(position) for position, _ in parts]
    materials = [scene.materials[body.material] for body in scene.bodies]
    volume = np.repeat([cell_volume for _, cell_volume in parts], number)
    features = [[getattr(material, name) for name in MATERIAL_FEATURES] for material in materials]
    return Particles(
        position=np.concatenate([position for position, _ in parts]),
        velocity=np.repeat([body.velocity for body in scene.bodies], number, axis=0),
        mass=volume * np.repeat([material.density for material in materials], number),
        volume=volume,
        material=np.repeat(np.array(features, dtype=np.float32), number, axis=0),
        material_name=np.repeat([names.index(body.material) for body in scene.bodies], number),
        particle_type=np.full(total, int(ParticleType.SAND), dtype=np.int64),
    )
