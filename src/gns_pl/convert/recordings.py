"""A foreign recording in SI units, block by block, and everything of it that does not change with time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.facts import Facts
from gns_pl.convert.formats import UNCERTAIN_MATERIAL, Recording, Stated
from gns_pl.convert.formats.source import without_material
from gns_pl.convert.material_value import material_question, tangents
from gns_pl.convert.own_scenes import carried_scene
from gns_pl.data.places import OutsideCounter
from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES, ParticleType
from gns_pl.scene import FACES, Body, Material, Scene, Wall, part_from_dict
from gns_pl.trajectory import Trajectory

TANGENT = MATERIAL_FEATURES[0]

BLOCK_BYTES = 32 * 1024 * 1024
"""Positions in memory at a time."""


@dataclass(frozen=True)
class Assumed:
    """What stands in a trajectory's scene where the source does not say; no learned simulator looks at it.

    Attributes:
        material: `Material` as plain values; its density weighs the particles.
        wall: `Wall` of every face as plain values.
    """

    material: Mapping[str, Any]
    wall: Mapping[str, Any]

    def plain(self, stated: Stated) -> dict[str, Any]:
        """Return the material with what the source states of it, as plain values."""
        values = {key: getattr(stated, key) for key in ("density", "friction_angle_deg")}
        return {**self.material, **{key: value for key, value in values.items() if value is not None}}


def si_blocks(recording: Recording, facts: Facts) -> Iterator[NDArray[np.float32]]:
    """Yield all frames of a recording in blocks, [n, N, D] [m], float32; exact where these are the source's own.

    Raises:
        InputError: frames that cannot be used, that float32 cannot hold, or with too many particles outside the box.
    """
    moved = types_of(recording, facts) != int(ParticleType.KINEMATIC)
    inside = OutsideCounter(facts.lower, facts.upper, margin=facts.spacing)
    size = max(1, BLOCK_BYTES // (8 * recording.num_particles * recording.dim))
    for start in range(0, recording.num_frames, size):
        block = in_si(recording.frames(start, start + size), facts)
        inside.count(block[:, moved])
        yield block
    try:
        inside.check()
    except InputError as error:
        raise InputError(f"{error}; give lower=… upper=…, or the right scale=….") from error


def in_si(position: NDArray[Any], facts: Facts) -> NDArray[np.float32]:
    """Return positions of a source along our axes [n, N, D] [m].

    Raises:
        InputError: another number of dimensions, or numbers that float32 cannot hold.
    """
    if position.shape[2] != facts.dim:
        raise InputError(f"has {position.shape[2]} dimensions, other trajectories of the set {facts.dim}.")
    turned = position[:, :, list(facts.axes)]
    if facts.scale != 1 or any(facts.origin):
        turned = turned.astype(np.float64) * facts.scale - np.array(facts.origin)
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(turned, dtype=np.float32)
    if not np.isfinite(single).all():
        raise InputError("holds positions that are too large for float32.")
    return single


def start_of(recording: Recording, facts: Facts, assumed: Assumed, stated: Stated, name: str) -> Trajectory:
    """Return the first frame of a recording with all that does not change with time.

    What the recording states of itself stands above what the set states; a scene of ours is carried over whole.

    Args:
        recording: open.
        facts: units and axes, of this recording (`Facts.of`).
        assumed: what the source does not say.
        stated: what it says of the whole set.
        name: of the scene, where the source has none.

    Raises:
        InputError: positions outside every box, or types without a moving particle.
    """
    features, values = _known_material(recording, facts)
    first = in_si(recording.frames(0, 1), facts)
    types = types_of(recording, facts)
    moved = types != int(ParticleType.KINEMATIC)
    if not moved.any():
        raise InputError("has kinematic particles alone, so nothing moves.")
    mass, stated = recording.mass, stated if recording.stated is None else merged(stated, recording.stated)
    if recording.scene is not None:
        scene = carried_scene(recording.scene, facts)
        if mass is not None:  # of the same density in another unit of length
            mass = mass * facts.scale**facts.dim
    else:
        plain = assumed.plain(stated)
        if TANGENT in features:
            tangent = values[moved, features.index(TANGENT)]
            plain["friction_angle_deg"] = math.degrees(math.atan(max(0.0, float(tangent.mean()))))
        material = part_from_dict(Material, "material", plain)
        scene = scene_of(first[0][moved], facts, material, assumed, name, (recording.num_frames - 1) * facts.dt)
    if mass is None:
        density = next(iter(scene.materials.values())).density
        mass = np.full(recording.num_particles, density * facts.spacing**facts.dim)
    return Trajectory(
        position=first,
        particle_type=types,
        material=values,
        material_features=features,
        mass=np.asarray(mass, dtype=np.float32),
        initial_velocity=_initial_velocity(recording, facts),
        dt=facts.dt,
        scene=scene.replace(origin=facts.origin_on_map(stated.origin)),
        provenance={},
    )


def _known_material(recording: Recording, facts: Facts) -> tuple[tuple[str, ...], NDArray[np.float32]]:
    """Return names of the material features and their values [N, K], what was of unknown meaning as tan φ.

    Raises:
        InputError: nobody said what they mean.
    """
    values = recording.material
    if recording.material_features != (UNCERTAIN_MATERIAL,):
        return recording.material_features, values
    if facts.material_value is None:
        raise InputError(f"{material_question(float(values.min()), float(values.max()))}.")
    if facts.material_value == "none":
        return (), without_material(len(values))
    return (TANGENT,), tangents(values, facts.material_value)


def merged(stated: Stated, own: Stated) -> Stated:
    """Return what a source says of its set, and over it what it says of one recording."""
    stated_here = {field.name: getattr(own, field.name) for field in fields(own)}
    return replace(stated, **{name: value for name, value in stated_here.items() if value not in (None, (), {})})


def types_of(recording: Recording, facts: Facts) -> NDArray[np.int64]:
    """Return the particle types of a recording, ours [N]."""
    return np.array([facts.types.get(int(kind), int(kind)) for kind in recording.particle_type], dtype=np.int64)


def scene_of(
    moved: NDArray[np.float32], facts: Facts, material: Material, assumed: Assumed, name: str, duration: float
) -> Scene:
    """Return a scene whose only body is the cuboid around the moved particles, each with half a spacing around it.

    Args:
        moved: their first positions [N, D] [m].
        facts: box and gravity.
        material: of the body.
        assumed: for the walls.
        name: of the scene.
        duration: of the recording [s].
    """
    lower = np.maximum(moved.min(axis=0) - facts.spacing / 2, facts.lower)
    upper = np.minimum(moved.max(axis=0) + facts.spacing / 2, facts.upper)
    if not (lower < upper).all():
        raise InputError(
            f"its particles start between {_rounded(moved.min(axis=0))} and {_rounded(moved.max(axis=0))}, outside the "
            f"box {_rounded(facts.lower)} to {_rounded(facts.upper)}; give lower=… upper=…"
        )
    corner, size = tuple(lower.tolist()), tuple((upper - lower).tolist())
    wall = part_from_dict(Wall, "wall", dict(assumed.wall))
    return Scene(
        name=name,
        lower=facts.lower,
        upper=facts.upper,
        gravity=facts.gravity,
        duration=max(duration, facts.dt),
        materials={"sand": material},
        bodies=(Body(corner, size, (0.0,) * facts.dim),),
        walls=dict.fromkeys(FACES[facts.dim], wall),
    )


def _initial_velocity(recording: Recording, facts: Facts) -> NDArray[np.float32]:
    """Return the velocity of the first frame [N, D] [m/s]: stated, or that of the same acceleration as next."""
    if recording.initial_velocity is not None:
        turned = recording.initial_velocity[:, list(facts.axes)] * facts.scale
        return np.asarray(turned, dtype=np.float32)
    if recording.num_frames == 1:
        return np.zeros((recording.num_particles, facts.dim), dtype=np.float32)
    frames = in_si(recording.frames(0, 3), facts).astype(np.float64)
    velocity = np.diff(frames, axis=0) / facts.dt
    first = velocity[0] if len(velocity) == 1 else 2 * velocity[0] - velocity[1]
    return np.asarray(first, dtype=np.float32)


def whole_trajectory(start: Trajectory, num_frames: int, blocks: Iterator[NDArray[np.float32]]) -> Trajectory:
    """Return a trajectory in memory, for formats that are written at once.

    Args:
        start: its first frame.
        num_frames: T.
        blocks: all its frames, as of `si_blocks`.
    """
    position = np.empty((num_frames, *start.position.shape[1:]), dtype=np.float32)
    done = 0
    for block in blocks:
        position[done : done + len(block)] = block
        done += len(block)
    return replace(start, position=position)


def _rounded(values: Any) -> list[float]:
    return [float(f"{value:.4g}") if math.isfinite(value) else math.nan for value in values]
