"""The specification of a data set, and the scenes drawn from it.

Every trajectory draws from a random stream of its own that depends on the seed, the name of its family and its number
in the family, and on nothing else: more trajectories, another family or more processes change none of the others.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.io import SPLITS
from gns_pl.scene import (
    Material,
    Scene,
    Wall,
    part_from_dict,
    sample_block_release,
    sample_column_collapse,
    sample_cube_drop,
)
from gns_pl.scene.catalogue import checked_range

KINDS: dict[str, tuple[Callable[..., Scene], tuple[str, ...]]] = {
    "cube_drop": (sample_cube_drop, ("domain", "side", "speed", "max_drop", "duration")),
    "block_release": (sample_block_release, ("domain", "length", "aspect_ratio", "at_wall", "duration")),
    "column_collapse": (sample_column_collapse, ("domain", "length", "aspect_ratio", "duration_tau")),
}
"""Kind of family → its sampler in the scene catalogue and the parameters it needs."""

_SCENES, _SPLITS, _OFFSETS = 0, 1, 2  # which of a family's random streams


@dataclass(frozen=True)
class Planned:
    """One trajectory of a data set, before it is simulated.

    Attributes:
        file_name: in the data set's folder.
        split: "train", "valid" or "test".
        scene: what to simulate.
        seed: of the solver's random placement.
        offsets: k of every lattice that is stored → which of the k^D lattices of every k-th point it is [D].
    """

    file_name: str
    split: str
    scene: Scene
    seed: int
    offsets: Mapping[int, tuple[int, ...]]


@dataclass(frozen=True)
class DatasetSpec:
    """What a data set is made from; plain values, as a YAML file has them.

    Attributes:
        name: a word for messages.
        seed: from which everything is drawn.
        frame_interval: time between frames [s].
        mpm: settings of the solver, `MPMConfig`.
        material: `Material` of every body.
        walls: face → `Wall`.
        gravity: magnitude [m/s²].
        families: name → {kind, count, valid, test, parameters of its kind}; `kind` may be left out if the name is one.
            `count` trajectories, of which `valid` and `test` are held out. A family may have walls and a material of
            its own, and a range `friction_angle_deg` from which every trajectory draws [degrees].
        store_every: k of every data set that is stored: every k-th lattice point per direction of each body.

    Raises:
        InputError: a value that cannot be used, in one sentence.
    """

    name: str
    seed: int
    frame_interval: float
    mpm: Mapping[str, Any]
    material: Mapping[str, Any]
    walls: Mapping[str, Any]
    gravity: float
    families: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    store_every: Sequence[int] = (1,)

    def __post_init__(self) -> None:
        _whole("data", "seed", self.seed)
        object.__setattr__(self, "store_every", _checked_store_every(self.store_every))
        for name in ("frame_interval", "gravity"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
                raise InputError(f"data: {name} must be a positive number, not {value!r}.")
        if not isinstance(self.mpm, Mapping):
            raise InputError("data: mpm must be a mapping of the solver's settings.")
        if not isinstance(self.families, Mapping) or not self.families:
            raise InputError("data: families must name at least one family of scenes.")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> DatasetSpec:
        """Build a specification from plain values.

        "root", where to put the data set, and "every", which of those stored to use, are no part of it.

        Raises:
            InputError: unknown or missing keys, or values that cannot be used.
        """
        try:
            plain = json.loads(json.dumps(data, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise InputError(f"data: must hold plain, finite values only ({error}).") from error
        if isinstance(plain, dict):
            plain = {key: value for key, value in plain.items() if key not in ("root", "every")}
        spec: DatasetSpec = part_from_dict(cls, "data", plain)
        return spec

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain values; `from_dict` is its inverse.

        A set of all points says nothing of `store_every`, as those made before there was anything else.
        """
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "store_every"}
        return plain if self.store_every == (1,) else {**plain, "store_every": list(self.store_every)}


def chosen_every(data: Mapping[str, Any]) -> int:
    """Return k of the lattice to use of a data set: its "every", else the first of its "store_every".

    Args:
        data: a specification as plain values.

    Raises:
        InputError: a lattice that is not stored.
    """
    stored = _checked_store_every(data.get("store_every", (1,)))
    every = data.get("every", stored[0])
    if isinstance(every, bool) or every not in stored:
        known = " or ".join(map(str, stored))
        raise InputError(f"data: every is {every!r}, but the set is stored with every {known}; choose one of these.")
    return int(every)


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
    if kind not in KINDS:
        raise InputError(f"{owner}: there is no kind {kind!r} of scenes; known are {', '.join(KINDS)}.")
    sampler, needed = KINDS[kind]
    counts = {key: _whole(owner, key, family.get(key, 0)) for key in ("count", "valid", "test")}
    if counts["valid"] + counts["test"] > counts["count"]:
        raise InputError(f"{owner}: valid and test are part of count and cannot exceed it.")
    known = {"kind", *counts, *needed, "walls", "material", "friction_angle_deg"}
    unknown, missing = sorted(set(family) - known), sorted(set(needed) - set(family))
    if unknown or missing:
        what = f"unknown key {', '.join(unknown)}" if unknown else f"missing key {', '.join(missing)}"
        raise InputError(f"{owner}: {what}; a {kind} has {', '.join(sorted(known))}.")
    common = {
        **{key: family[key] for key in needed},
        "gravity": spec.gravity,
        "walls": _walls(owner, family.get("walls", spec.walls)),
    }
    material = part_from_dict(Material, f"{owner}: material", family.get("material", spec.material))
    angles = family.get("friction_angle_deg")
    if angles is not None:
        angles = checked_range(owner, "friction_angle_deg", angles)
        for angle in angles:
            replace(material, friction_angle_deg=angle)  # refuses what no sand has, before a draw happens to hit it
    splits = _draw_splits(spec.seed, name, **counts)
    planned = []
    for number in range(counts["count"]):
        stream, placement, friction = _sequence(spec.seed, name, _SCENES, number).spawn(3)
        if angles is not None:
            material = replace(material, friction_angle_deg=np.random.default_rng(friction).uniform(*angles))
        scene = sampler(np.random.default_rng(stream), **common, material=material, name=f"{name}_{number:04d}")
        seed = int(placement.generate_state(1)[0])
        offsets = {every: _offset(spec.seed, name, number, every, scene.dim) for every in spec.store_every}
        planned.append(Planned(f"trajectory_{first + number:04d}.h5", splits[number], scene, seed, offsets))
    return planned


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


def _checked_store_every(value: Any) -> tuple[int, ...]:
    whole = isinstance(value, list | tuple) and all(type(every) is int and every >= 1 for every in value)
    if not whole or not value or len(set(value)) != len(value):
        raise InputError(f"data: store_every must list different whole numbers of at least 1, not {value!r}.")
    return tuple(value)


def _whole(owner: str, name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{owner}: {name} must be a whole number of at least 0, not {value!r}.")
    return value
