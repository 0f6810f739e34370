"""The scenes of a data set, drawn from its specification.

Every trajectory draws from a random stream of its own that depends on the seed, the name of its family and its number
in the family, and on nothing else: more trajectories, another family or more processes change none of the others.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.generation.kinds import find_kind
from gns_pl.generation.spec import FROM_FILES, DatasetSpec, whole_number
from gns_pl.io import SPLITS
from gns_pl.scene import Material, Scene, Wall, part_from_dict, scene_from_dict
from gns_pl.scene.catalogue import checked_range

_SCENES, _SPLITS, _OFFSETS = 0, 1, 2  # which of a family's random streams


@dataclass(frozen=True)
class Planned:
    """One trajectory of a data set, before it is simulated.

    Attributes:
        file_name: in the data set's folder.
        split: "train", "valid" or "test".
        scene: what to simulate.
        seed: of the solver's random placement.
        offsets: k of all that is stored → which of the k^D lattices of every k-th point it is [D]; None where points
            are drawn, by the seed of the placement.
    """

    file_name: str
    split: str
    scene: Scene
    seed: int
    offsets: Mapping[int, tuple[int, ...] | None]


def draw_plan(spec: DatasetSpec) -> list[Planned]:
    """Draw every scene of a data set, in the order of their files.

    Raises:
        InputError: a family that cannot be drawn, or splits without a training trajectory.
    """
    plan: list[Planned] = []
    for name in sorted(spec.families):
        plan += _draw_family(spec, name, len(plan))
    if len({planned.scene.dim for planned in plan}) > 1:
        raise InputError("data: all families must have the same number of dimensions.")
    if not any(planned.split == "train" for planned in plan):
        raise InputError("data: no trajectory is left for training; raise count or lower valid and test.")
    return plan


def _draw_family(spec: DatasetSpec, name: str, first: int) -> list[Planned]:
    owner = f"data: family {name}"
    family = spec.families[name]
    if not isinstance(family, Mapping):
        raise InputError(f"{owner} must be a mapping, not {type(family).__name__}.")
    kind = family.get("kind", name)
    if kind == FROM_FILES:
        return _given_family(spec, owner, name, first)
    drawn = find_kind(owner, kind)
    counts = {key: whole_number(owner, key, family.get(key, 0)) for key in ("count", "valid", "test")}
    if counts["valid"] + counts["test"] > counts["count"]:
        raise InputError(f"{owner}: valid and test are part of count and cannot exceed it.")
    shared = {"kind", *counts, "walls", "material", "friction_angle_deg", "slope_deg"}
    known = {*shared, *drawn.needed, *drawn.optional}
    unknown = sorted(set(family) - known) if drawn.checked else []
    missing = sorted(set(drawn.needed) - set(family))
    if unknown or missing:
        what = f"unknown key {', '.join(unknown)}" if unknown else f"missing key {', '.join(missing)}"
        raise InputError(f"{owner}: {what}; a {kind} has {', '.join(sorted(known))}.")
    own = {key: value for key, value in family.items() if key not in shared}
    walls = _walls(owner, family.get("walls", spec.walls))
    material = part_from_dict(Material, f"{owner}: material", family.get("material", spec.material))
    angles = family.get("friction_angle_deg")
    if angles is not None:
        angles = checked_range(owner, "friction_angle_deg", angles)
        for angle in angles:
            replace(material, friction_angle_deg=angle)  # refuses what no sand has, before a draw happens to hit it
    slopes = family.get("slope_deg")
    if slopes is not None:
        slopes = checked_range(owner, "slope_deg", slopes)
        if slopes[1] >= 90:
            raise InputError(f"{owner}: slope_deg must lie below 90, not {slopes[1]:g}.")
    splits = _draw_splits(spec.seed, name, **counts)
    planned = []
    for number in range(counts["count"]):
        stream, placement, friction, slope = _sequence(spec.seed, name, _SCENES, number).spawn(4)
        if angles is not None:
            material = replace(material, friction_angle_deg=np.random.default_rng(friction).uniform(*angles))
        common = {"gravity": spec.gravity, "walls": walls, "material": material, "name": f"{name}_{number:04d}"}
        taken = {key: common[key] for key in drawn.common}
        scene = drawn.sampler(np.random.default_rng(stream), **own, **taken)
        if slopes is not None:
            scene = _tilted(scene, np.random.default_rng(slope).uniform(*slopes))
        _check_scene(spec, owner, scene)
        planned.append(_planned(spec, name, number, first, splits[number], scene, placement))
    return planned


def _tilted(scene: Scene, slope: float) -> Scene:
    """Return a scene on a slope [degrees] that falls along x: its box is as it was, its gravity is tilted."""
    angle, size = math.radians(slope), math.hypot(*scene.gravity)
    level = (0.0,) * (scene.dim - 2)
    return scene.replace(gravity=(size * math.sin(angle), *level, -size * math.cos(angle)))


def _planned(
    spec: DatasetSpec,
    family: str,
    number: int,
    first: int,
    split: str,
    scene: Scene,
    placement: np.random.SeedSequence,
) -> Planned:
    lattice = spec.sampling == "lattice"
    offsets = {
        every: _offset(spec.seed, family, number, every, scene.dim) if lattice else None for every in spec.store_every
    }
    seed = int(placement.generate_state(1)[0])
    return Planned(f"trajectory_{first + number:04d}.h5", split, scene, seed, offsets)


def _given_family(spec: DatasetSpec, owner: str, name: str, first: int) -> list[Planned]:
    """Plan a family whose scenes are given; every one of its `placements` fills it anew."""
    family = spec.families[name]
    unknown = sorted(set(family) - {"kind", FROM_FILES, "placements", "valid", "test"})
    if unknown or FROM_FILES not in family:
        what = f"unknown key {', '.join(unknown)}" if unknown else "missing key files"
        raise InputError(f"{owner}: {what}; a family of scenes has files, placements, valid, test.")
    scenes = [scene_from_dict(content) for content in family[FROM_FILES]]
    for scene in scenes:
        _check_scene(spec, owner, scene)
    placements = whole_number(owner, "placements", family.get("placements", 1))
    counts = {key: whole_number(owner, key, family.get(key, 0)) for key in ("valid", "test")}
    count = len(scenes) * placements
    if sum(counts.values()) > count:
        raise InputError(f"{owner}: valid and test are part of its {count} trajectories and cannot exceed them.")
    splits = _draw_splits(spec.seed, name, count=count, **counts)
    planned = []
    for number in range(count):
        _, placement, _ = _sequence(spec.seed, name, _SCENES, number).spawn(3)
        scene = scenes[number % len(scenes)]
        scene = scene.replace(name=f"{scene.name}_{number // len(scenes):04d}") if placements > 1 else scene
        planned.append(_planned(spec, name, number, first, splits[number], scene, placement))
    return planned


def _check_scene(spec: DatasetSpec, owner: str, scene: Scene) -> None:
    """Refuse another gravity than the data set's, but for a slope."""
    if scene.gravity[-1] >= 0 or not math.isclose(math.hypot(*scene.gravity), spec.gravity, rel_tol=1e-3):
        raise InputError(
            f"{owner}: scene {scene.name!r} has the gravity {list(scene.gravity)}, and the data set "
            f"{spec.gravity:g} m/s² downwards or tilted; set data.gravity, or change the scene."
        )


def _offset(seed: int, family: str, number: int, every: int, dim: int) -> tuple[int, ...]:
    """Return which lattice of every k-th point a trajectory keeps.

    They are taken in turn from a random one on, so that a family shows each of the k^D once before any comes again.
    """
    place = int(_sequence(seed, family, _OFFSETS, every).generate_state(1)[0]) + number
    return tuple(place // every**axis % every for axis in range(dim))


def _draw_splits(seed: int, family: str, *, count: int, valid: int, test: int) -> list[str]:
    order = np.random.default_rng(_sequence(seed, family, _SPLITS)).permutation(count)
    splits = np.full(count, SPLITS.index("train"))
    splits[order[:valid]] = SPLITS.index("valid")
    splits[order[valid : valid + test]] = SPLITS.index("test")
    return [SPLITS[split] for split in splits]


def _sequence(seed: int, family: str, *place: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(zlib.crc32(family.encode()), *place))


def _walls(owner: str, walls: Any) -> dict[str, Wall]:
    if not isinstance(walls, Mapping):
        raise InputError(f"{owner}: walls must be a mapping of faces to walls.")
    return {str(face): part_from_dict(Wall, f"{owner}: wall {face!r}", wall) for face, wall in walls.items()}
