"""A scene as plain dicts, YAML and JSON, and back; unknown and missing keys are named."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from gns_pl.errors import InputError
from gns_pl.presets import FOLDER, scene_names
from gns_pl.scene.boundaries import Box, Obstacle, Plane, Wall
from gns_pl.scene.changes import changed
from gns_pl.scene.definition import Material, Scene
from gns_pl.scene.ground import bodies_from_list, default_box, terrain_from_dict
from gns_pl.scene.origin import near_origin
from gns_pl.scene.parts import part_from_dict

OBSTACLES: dict[str, type[Obstacle]] = {"plane": Plane, "box": Box}
"""Kind of obstacle → its class."""


def scene_from_dict(data: Mapping[str, Any], folder: str | Path = "") -> Scene:
    """Build a `Scene` from its plain-dict form.

    Args:
        data: plain values.
        folder: in which files lie that a terrain or a release names.

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
    box, terrain = (parts.get("lower"), parts.get("upper")), parts.get("terrain")
    if terrain is not None:
        terrain = parts["terrain"] = terrain_from_dict(terrain, Path(folder), *box)
    parts["bodies"] = bodies_from_list(parts["bodies"], terrain, Path(folder))
    if terrain is not None and box == (None, None):
        parts["lower"], parts["upper"] = default_box(terrain, parts["bodies"])
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
        data = _parsed(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise InputError(f"{path}: is not YAML or JSON ({line}{error.problem or error.context}).") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        raise InputError(f"{path}: is not YAML or JSON.") from None
    try:
        return near_origin(scene_from_dict(changed(data, changes or {}, "the scene"), path.parent))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _parsed(path: Path) -> Any:
    """Return the plain values in a file: JSON by its own parser, which is fast with the heights of a terrain."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        with contextlib.suppress(json.JSONDecodeError):
            return json.loads(text)
    return yaml.safe_load(text)  # which says where, if it is not JSON


def write_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene to `path` as JSON (`.json`) or YAML (any other ending)."""
    path = Path(path)
    data = scene.to_dict()
    text = json.dumps(data, indent=2) if path.suffix == ".json" else yaml.safe_dump(data, sort_keys=False)
    path.write_text(text, encoding="utf-8")
