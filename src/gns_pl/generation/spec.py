"""The specification of a data set, as plain values; `families` draws the scenes from it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.scene import (
    part_from_dict,
    read_scene,
)

FROM_FILES = "scenes"
"""The kind of a family whose scenes are given, by files or as plain values."""

SAMPLINGS = ("lattice", "stratified")
"""Ways to choose the points that are stored; sets made before there was another have lattices."""


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
            its own, and ranges from which every trajectory draws: `friction_angle_deg`, and `slope_deg`, by which
            gravity is tilted along x [degrees]. A family of the kind `scenes` has `files` of scenes, or `scenes` as
            plain values, and `placements`: trajectories of each.
        store_every: k of every data set that is stored: one of k^D points of each body.
        sampling: which one: "lattice" keeps every k-th lattice point per direction, "stratified" a point drawn in each
            block of k^D, which is as far out as all points are (`generation.thinning`).

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
    sampling: str = "lattice"

    def __post_init__(self) -> None:
        whole_number("data", "seed", self.seed)
        object.__setattr__(self, "store_every", _checked_store_every(self.store_every))
        for name in ("frame_interval", "gravity"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
                raise InputError(f"data: {name} must be a positive number, not {value!r}.")
        if self.sampling not in SAMPLINGS:
            raise InputError(f"data: sampling must be {' or '.join(SAMPLINGS)}, not {self.sampling!r}.")
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
            plain["families"] = _with_scenes(plain.get("families"))
        spec: DatasetSpec = part_from_dict(cls, "data", plain)
        return spec

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain values; `from_dict` is its inverse.

        A set of all points says nothing of `store_every` and one of lattices nothing of `sampling`, as those made
        before there was anything else.
        """
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__}
        plain["store_every"] = list(self.store_every)
        usual = {"store_every": [1], "sampling": SAMPLINGS[0]}
        return {name: value for name, value in plain.items() if name not in usual or value != usual[name]}


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


def _with_scenes(families: Any) -> Any:
    """Return families whose files of scenes are read, so that a specification is whole without them."""
    if not isinstance(families, Mapping):
        return families
    whole = {}
    for name, family in families.items():
        if isinstance(family, Mapping) and family.get("kind", name) == FROM_FILES and "files" in family:
            files = family["files"]
            if not isinstance(files, list) or not files or not all(isinstance(file, str) for file in files):
                raise InputError(f"data: family {name}: files must list scene files, not {files!r}.")
            rest = {key: value for key, value in family.items() if key != "files"}
            whole[name] = {**rest, FROM_FILES: [read_scene(Path(file)).to_dict() for file in files]}
        else:
            whole[name] = family
    return whole


def _checked_store_every(value: Any) -> tuple[int, ...]:
    whole = isinstance(value, list | tuple) and all(type(every) is int and every >= 1 for every in value)
    if not whole or not value or len(set(value)) != len(value):
        raise InputError(f"data: store_every must list different whole numbers of at least 1, not {value!r}.")
    return tuple(value)


def whole_number(owner: str, name: str, value: Any) -> int:
    """Return a whole number of at least 0, or raise an `InputError` that names it."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{owner}: {name} must be a whole number of at least 0, not {value!r}.")
    return value
