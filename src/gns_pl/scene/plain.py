"""A scene as plain dicts, YAML and JSON, and back; unknown and missing keys are named."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from gns_pl.errors import InputError
from gns_pl.presets import FOLDER, scene_names
from gns_pl.scene.boundaries import Box, Obstacle, Plane, Wall
from gns_pl.scene.changes import changed
from gns_pl.scene.definition import Body, Material, Scene
from gns_pl.scene.origin import near_origin
from gns_pl.text import did_you_mean

OBSTACLES: dict[str, type[Obstacle]] = {"plane": Plane, "box": Box}
"""Kind of obstacle → its class."""


def part_from_dict(cls: type, owner: str, data: Any) -> Any:
    """Construct a dataclass from a mapping; unknown and missing keys are named."""
    if not isinstance(data, Mapping):
        raise InputError(f"{owner} must be a mapping of names to values, not {type(data).__name__}.")
    known = {field.name: field for field in dataclasses.fields(cls)}
    unknown = [str(key) for key in data if key not in known]
    if unknown:
        meant = did_you_mean(unknown[0], known)
        raise InputError(f"{owner}: unknown key {', '.join(unknown)}{meant}; known are {', '.join(known)}.")
    missing = [name for name, f in known.items() if f.default is dataclasses.MISSING and name not in data]
    if missing:
        raise InputError(f"{owner}: missing key {', '.join(missing)}.")
    return cls(**data)


def scene_from_dict(data: Mapping[str, Any]) -> Scene:
    """Build a `Scene` from its plain-dict form.

    Raises:
        InputError: unknown or missing keys, or values a `Scene` refuses.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"a scene must be a mapping of names to values, not {type(data).__name__}.")
    parts = dict(data)
    for key, cls in (("materials", Material), ("walls", Wall)):
        value = parts.get(key, {})
        if not isinstance(value, Mapping):
            raise InputError(f"scene: {key} must be a mapping, not {type(value).__name__}.")
        parts[key] = {str(name): part_from_dict(cls, f"{key[:-1]} {name!r}", entry) for name, entry in value.items()}
    for key in ("bodies", "obstacles"):
        value = parts.setdefault(key, ())
        if not isinstance(value, list | tuple):
            raise InputError(f"scene: {key} must be a list, not {type(value).__name__}.")
    parts["bodies"] = tuple(part_from_dict(Body, f"body {index}", body) for index, body in enumerate(parts["bodies"]))
    parts["obstacles"] = tuple(_obstacle(f"obstacle {index}", entry) for index, entry in enumerate(parts["obstacles"]))
    scene: Scene = part_from_dict(Scene, "scene", parts)
    return scene


def _obstacle(owner: str, data: Any) -> Obstacle:
    if not isinstance(data, Mapping):
        raise InputError(f"{owner} must be a mapping of names to values, not {type(data).__name__}.")
    parts = dict(data)
    kind = parts.pop("kind", None)
    if not isinstance(kind, str) or kind not in OBSTACLES:
        raise InputError(f"{owner}: kind must be one of {', '.join(OBSTACLES)}, not {kind!r}.")
    if "wall" in parts:
        parts["wall"] = part_from_dict(Wall, f"{owner}: wall", parts["wall"])
    obstacle: Obstacle = part_from_dict(OBSTACLES[kind], f"{owner}, a {kind}", parts)
    return obstacle


def scene_path(name: str | Path) -> Path:
    """Return the file of a scene: one that is there, or that of a scene of the package, as "corner"; else as named."""
    shipped = FOLDER / "scenes" / f"{name}.yaml"
    return shipped if not Path(name).exists() and str(name) in scene_names() else Path(name)


def read_scene(path: str | Path, changes: Mapping[str, Any] | None = None) -> Scene:
    """Read a scene from a `.yaml`, `.yml` or `.json` file; one on a map is moved near zero (`Scene.origin`).

    Args:
        path: the file, or the name of a scene that comes with the package (conf/scenes).
        changes: dotted key → value that takes the place of the file's (`scene.changes`).

    Raises:
        InputError: no such file, not YAML or JSON, or not a scene; the file is named, and the line if it is known.
    """
    path = scene_path(path)
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))  # JSON is YAML
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise InputError(f"{path}: is not YAML or JSON ({line}{error.problem or error.context}).") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        raise InputError(f"{path}: is not YAML or JSON.") from None
    try:
        return near_origin(scene_from_dict(changed(data, changes or {}, "the scene")))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def write_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene to `path` as JSON (`.json`) or YAML (any other ending)."""
    path = Path(path)
    data = scene.to_dict()
    text = json.dumps(data, indent=2) if path.suffix == ".json" else yaml.safe_dump(data, sort_keys=False)
    path.write_text(text, encoding="utf-8")
