"""A scene as it was named on the command line: from the catalogue, a file or a function, with changes."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.extensions import imported_function
from gns_pl.scene import Material, Scene, Wall, column_collapse, part_from_dict, read_scene
from gns_pl.scene.changes import changed, changes_label
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.text import did_you_mean

SHARED = ("gravity", "material", "walls")
"""Arguments of a scene's function that come from the catalogue unless it has values of its own for them."""

FUNCTION = re.compile(r"(?!.*\.(?:ya?ml|json)$)[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+")
"""What names a function, and no file of a scene."""


def named_scene(name: Any, catalogue: Mapping[str, Any], changes: Mapping[str, Any], label: str = "") -> Scene:
    """Return a scene of the catalogue (conf/simulate.yaml), of a file or of a function, with changes in its name.

    Args:
        name: of the catalogue, or a file, or "MODULE.FUNCTION".
        catalogue: name → arguments of the scene's function; "kind" names the function, as in `KINDS` or as
            "MODULE.FUNCTION", where it has another name than the scene.
        changes: dotted key → value in the place of the scene's own.
        label: what tells a job from the others of its sweep; it goes into the name.

    Raises:
        InputError: no such scene, or a key that it has not.
    """
    if not isinstance(name, str):
        raise InputError(f"scene: a file or a name is needed, not {name!r}.")
    if name in catalogue:
        given = dict(catalogue[name])
        scene = _build(given.pop("kind", name), name, given, changes)
    elif Path(name).exists():
        scene = read_scene(Path(name), changes)
    elif FUNCTION.fullmatch(name):
        scene = _build(name, name.rpartition(".")[2], _arguments(name, catalogue), changes)
    else:
        known = [*catalogue, *(str(path) for path in sorted(Path(name).parent.glob("*.y*ml")))]
        raise InputError(
            f"{name}: there is no such scene file{did_you_mean(name, known)}; the catalogue has {', '.join(catalogue)}."
        )
    return scene.replace(name="_".join(filter(None, (scene.name, changes_label(changes), label))))


def _build(kind: str, name: str, given: Mapping[str, Any], changes: Mapping[str, Any]) -> Scene:
    """Return the scene that a function makes of arguments and changes."""
    function = _function(kind)
    parts = changed(given, changes, name)
    unknown = [key for key in parts if key not in (*given, "name")]
    if unknown:
        meant, there = did_you_mean(unknown[0], given), ", ".join(given)
        raise InputError(f"scene.{unknown[0]}: {name} has no such key{meant}; there are {there}.")
    parts["name"] = str(parts.get("name", name))
    owner = f"scene {parts['name']!r}"
    if "material" in parts:
        parts["material"] = part_from_dict(Material, "material", parts["material"])
    if "walls" in parts:
        parts["walls"] = _walls(owner, parts["walls"])
    try:
        scene = function(**parts)
    except TypeError as error:
        raise InputError(f"{owner}: {kind}: {error}.") from error
    if not isinstance(scene, Scene):
        raise InputError(f"{owner}: {kind} must return a Scene, not {type(scene).__name__}.")
    return scene


def _function(kind: str) -> Callable[..., Any]:
    function: Callable[..., Any] = KINDS[kind] if kind in KINDS else imported_function(kind, "scene", sorted(KINDS))
    return function


def _arguments(kind: str, catalogue: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a function that stands in no catalogue: its own values, and the shared ones there."""
    shared = {key: value for entry in catalogue.values() for key, value in entry.items() if key in SHARED}
    parameters = inspect.signature(_function(kind)).parameters.values()
    given = {
        parameter.name: parameter.default
        for parameter in parameters
        if parameter.default is not inspect.Parameter.empty
    }
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}
    return {**{parameter.name: shared[parameter.name] for parameter in parameters if parameter.name in shared}, **plain}


def _walls(owner: str, walls: Any) -> dict[str, Wall]:
    if not isinstance(walls, Mapping):
        raise InputError(f"{owner}: walls must be a mapping, not {walls!r}.")
    return {face: part_from_dict(Wall, f"wall {face}", wall) for face, wall in walls.items()}


def column(
    *,
    length: float,
    aspect_ratio: float,
    domain: Sequence[float],
    duration_tau: float,
    gravity: float,
    material: Material,
    walls: Mapping[str, Wall],
    side_walls: Mapping[str, Any] | None,
    name: str,
) -> Scene:
    """Return a `column_collapse` of a length and an aspect ratio.

    Args:
        length: L0 [m].
        aspect_ratio: H0 / L0.
        domain: edges of the box [D] [m].
        duration_tau: simulated time [√(H0/g)].
        gravity: magnitude [m/s²].
        material: of the column.
        walls: face → wall.
        side_walls: of y- and y+ in place of those, in plain values.
        name: of the scene.
    """
    owner = f"scene {name!r}"
    numbers = {"length": length, "aspect_ratio": aspect_ratio, "duration_tau": duration_tau, "gravity": gravity}
    length, ratio, tau, gravity = (checked_number(owner, key, numbers[key], 0.0, above=True) for key in numbers)
    height = length * ratio
    return column_collapse(
        domain=checked_numbers(owner, "domain", domain),
        length=length,
        height=height,
        gravity=gravity,
        duration=tau * math.sqrt(height / gravity),
        material=material,
        walls={**walls, **(_walls(owner, {"y-": side_walls, "y+": side_walls}) if side_walls else {})},
        name=name,
    )


KINDS: dict[str, Callable[..., Scene]] = {"column_collapse": column}
"""Name → function that makes a scene of keywords in plain values, but for a `Material` and walls (face → `Wall`)."""
