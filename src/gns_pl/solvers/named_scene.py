"""A scene as it was named on the command line: from the catalogue or from a file, with changes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.presets import scene_names
from gns_pl.scene import Material, Scene, Wall, column_collapse, part_from_dict, read_scene
from gns_pl.scene.changes import changed, changes_label
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.plain import scene_path
from gns_pl.text import did_you_mean

COLUMN = ("length", "aspect_ratio", "duration_tau", "gravity")
"""Numbers of a column of the catalogue."""


def named_scene(name: Any, catalogue: Mapping[str, Any], changes: Mapping[str, Any], label: str = "") -> Scene:
    """Return a scene of the catalogue (conf/simulate.yaml), of the package or of a file, with changes in its name.

    Args:
        name: of the catalogue, of the package (conf/scenes), or a file.
        catalogue: name → what a column is made from.
        changes: dotted key → value in the place of the scene's own.
        label: what tells a job from the others of its sweep; it goes into the name.

    Raises:
        InputError: no such scene, or a key that it has not.
    """
    if not isinstance(name, str):
        raise InputError(f"scene: a file or a name is needed, not {name!r}.")
    if name in catalogue:
        parts = changed(catalogue[name], changes, name)
        unknown = [key for key in parts if key not in (*catalogue[name], "name")]
        if unknown:
            meant, there = did_you_mean(unknown[0], catalogue[name]), ", ".join(catalogue[name])
            raise InputError(f"scene.{unknown[0]}: {name} has no such key{meant}; there are {there}.")
        scene = _column(parts, str(parts.get("name", name)))
    elif scene_path(name).exists():
        scene = read_scene(name, changes)
    else:
        shipped = scene_names()
        known = [*catalogue, *shipped, *(str(path) for path in sorted(Path(name).parent.glob("*.y*ml")))]
        raise InputError(
            f"{name}: there is no such scene file{did_you_mean(name, known)}; the catalogue has "
            f"{', '.join(catalogue)}, and the package {', '.join(shipped)}."
        )
    return scene.replace(name="_".join(filter(None, (scene.name, changes_label(changes), label))))


def _column(parts: Mapping[str, Any], name: str) -> Scene:
    owner = f"scene {name!r}"
    numbers = {key: checked_number(owner, key, parts[key], 0.0, above=True) for key in COLUMN}
    gravity, height = numbers["gravity"], numbers["length"] * numbers["aspect_ratio"]
    side, walls = parts["side_walls"], parts["walls"]
    if not isinstance(walls, Mapping):
        raise InputError(f"{owner}: walls must be a mapping, not {walls!r}.")
    sides = {"y-": side, "y+": side} if side else {}
    return column_collapse(
        domain=checked_numbers(owner, "domain", parts["domain"]),
        length=numbers["length"],
        height=height,
        gravity=gravity,
        duration=numbers["duration_tau"] * math.sqrt(height / gravity),
        material=part_from_dict(Material, "material", parts["material"]),
        walls={face: part_from_dict(Wall, f"wall {face}", wall) for face, wall in {**walls, **sides}.items()},
        name=name,
    )
