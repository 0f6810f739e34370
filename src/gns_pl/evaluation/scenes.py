"""The scenes an evaluation runs: columns by their edges, or any scene from a file of its own.

A column takes its material, its walls and its gravity from the data of the checkpoint.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from gns_pl.errors import InputError
from gns_pl.scene import Material, Scene, Wall, column_collapse, part_from_dict, read_scene
from gns_pl.scene.extent import characteristic_time, check_frame_interval, num_frames

T = TypeVar("T")


def build_scenes(
    columns: Mapping[str, Any],
    files: Sequence[str] | str | None,
    *,
    only: Sequence[str] | str | None,
    domain: Sequence[float],
    duration: float,
    interval: float,
    data: Mapping[str, Any],
) -> dict[str, Scene]:
    """Return name → scene.

    Args:
        columns: name → {length, height} of a column [m].
        files: scene files, or names of scenes of the package, which are run in the columns' place under their own
            names; None for the columns.
        only: names to keep; None keeps all.
        domain: edge lengths of the columns' box, x, y and z [m]; y is left out for data in two dimensions.
        duration: simulated time of the columns, in characteristic times τc.
        interval: time between frames [s]; the duration is rounded up to whole frames.
        data: the specification of the checkpoint's data; its gravity, material and walls are the columns'.

    Raises:
        InputError: an unknown name in `only`, no scene at all, two of one name, a scene that cannot be built or is
            shorter than a frame, or data that do not say what they are made of.
    """
    if not isinstance(duration, int | float) or not (math.isfinite(duration) and duration > 0):
        raise InputError(f"evaluation.duration must be positive, in characteristic times, not {duration}.")
    check_frame_interval(interval)
    scenes: dict[str, Scene] = {}
    if files is not None:
        for file in [files] if isinstance(files, str) else files:
            scene = read_scene(file)
            characteristic_time(scene)  # refuses a scene without gravity before it is simulated
            num_frames(scene, interval)  # and one that is shorter than a frame
            if scene.name in scenes:
                raise InputError(f"evaluation.scenes: two scenes are called {scene.name!r}; rename one in its file.")
            scenes[scene.name] = scene
        return chosen(scenes, only, "evaluation.scenes")
    for name, spec in chosen({key: spec for key, spec in columns.items() if spec is not None}, only).items():
        scene = _column(name, spec, domain, data)
        frames = math.ceil(duration * characteristic_time(scene) / interval - 1e-6)
        scenes[name] = scene.replace(duration=frames * interval)
    return scenes


def chosen(
    scenes: Mapping[str, T],
    only: Sequence[str] | str | None,
    what: str = "evaluation.columns",
    key: str = "evaluation.only",
) -> dict[str, T]:
    """Return those that are wanted.

    Args:
        scenes: name → anything.
        only: names to keep; None keeps all.
        what: they come from, for messages.
        key: that names those to keep, for messages.

    Raises:
        InputError: an unknown name, one that can name no file, or nothing left.
    """
    only = [only] if isinstance(only, str) else only
    unknown = [name for name in only or () if name not in scenes]
    if unknown:
        raise InputError(f"{key}: there is no {', '.join(unknown)}; known are {', '.join(scenes)}.")
    selected = {name: scene for name, scene in scenes.items() if not only or name in only}
    if not selected:
        raise InputError(f"{what}: there is no scene to evaluate.")
    for name in selected:
        if not re.fullmatch(r"[\w.-]+", name):
            raise InputError(f"{what}: {name!r} must be a word (letters, digits, . _ -): it names files.")
    return selected


def _column(name: str, spec: Any, domain: Sequence[float], data: Mapping[str, Any]) -> Scene:
    if not isinstance(spec, Mapping) or sorted(spec) != ["height", "length"]:
        raise InputError(f"evaluation.columns.{name} must be {{length, height}} in metres.")
    missing = [key for key in ("gravity", "material", "walls") if key not in data]
    if missing:
        raise InputError(
            f"this checkpoint's data do not state their {', '.join(missing)}, so no column can be built; "
            "give scene files: 'evaluation.scenes=[scene.yaml]'."
        )
    box = list(domain) if len(data["walls"]) == 6 else [domain[0], domain[-1]]
    geometry: dict[str, Any] = {
        "domain": box,
        "length": spec["length"],
        "height": spec["height"],
        "gravity": data["gravity"],
        "material": part_from_dict(Material, "the checkpoint's material", data["material"]),
        "walls": {
            face: part_from_dict(Wall, f"the checkpoint's wall {face}", data["walls"][face]) for face in data["walls"]
        },
        "name": name,
    }
    return column_collapse(duration=1.0, **geometry)
