"""What the scenes that a solver was fitted to have in common, and what of another scene lies outside of that."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gns_pl.scene import Scene
from gns_pl.scene.definition import Material
from gns_pl.scene.extent import initial_extent
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.solvers.solver import characteristic_size

SPANS = {
    "size": ("√(L0 H0)", " m"),
    "aspect_ratio": ("aspect ratios", ""),
    "bodies": ("numbers of bodies", ""),
    "obstacles": ("numbers of obstacles", ""),
    "slope_deg": ("slopes", "°"),
    "speed": ("initial speeds", " m/s"),
    "drop": ("drops", " m"),
    "gravity": ("gravity", " m/s²"),
}
"""Number that describes a scene → what it is called, and its unit."""


def range_of(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Return what scenes span, as plain values: smallest and largest of `SPANS`, and all materials and walls."""
    numbers = [_numbers(scene) for scene in scenes]
    materials = {material for scene in scenes for material in _materials(scene)}
    walls = {wall for scene in scenes for wall in _walls(scene)}
    return {
        **{key: [float(f"{pick(each[key] for each in numbers):.6g}") for pick in (min, max)] for key in SPANS},
        "materials": [dataclasses.asdict(material) for material in sorted(materials, key=str)],
        "walls": sorted(walls),
    }


def beyond(scene: Scene, span: Mapping[str, Any]) -> Iterator[str]:
    """Yield what of a scene is outside a range of `range_of`, in words; an empty range refuses nothing."""
    for key, value in _numbers(scene).items():
        low, high = span.get(key, (-math.inf, math.inf))
        if not low - 0.01 * abs(low) - 1e-9 <= value <= high + 0.01 * abs(high) + 1e-9:
            name, unit = SPANS[key]
            yield f"fitted to {name} of {low:.3g} to {high:.3g}{unit}, here {value:.3g}"
    if "materials" in span and not {tuple(vars(each).items()) for each in _materials(scene)} <= {
        tuple(each.items()) for each in span["materials"]
    }:
        yield "fitted to another material"
    unknown = _walls(scene) - set(span.get("walls", _walls(scene)))
    if unknown:
        yield f"fitted with other walls ({'; '.join(span['walls'])}), here {'; '.join(sorted(unknown))}"


def _materials(scene: Scene) -> set[Material]:
    return {scene.materials[body.material] for body in scene.bodies}


def _walls(scene: Scene) -> set[str]:
    """Return the walls that material may reach, each with its place and the dimensions of the scene, in words.

    A scene in plane strain has the walls of its slice. Nothing rises to the lid.
    """
    scene = _sliced(scene)
    kind = "in plane strain" if scene.dim == 2 else "in space"
    places = {face[0]: set[str]() for face in scene.walls} | {"obstacle": set[str]()}
    for face, wall in scene.walls.items():
        if face != "z+":
            places[face[0]].add(wall.description)
    for obstacle in scene.obstacles:
        places["obstacle"].add(obstacle.wall.description)
    if scene.terrain is not None:
        places["terrain"] = {scene.terrain.wall.description}
    return {f"{kind} {place}: {words}" for place, walls in places.items() for words in walls}


def _sliced(scene: Scene) -> Scene:
    reduction = reduce_scene(scene)
    return scene if reduction.across is None else reduction.scene


def _numbers(scene: Scene) -> dict[str, float]:
    length, height = initial_extent(scene)
    return {
        "size": characteristic_size(scene),
        "aspect_ratio": height / length,
        "bodies": len(scene.bodies),
        "obstacles": len(scene.obstacles),
        "slope_deg": math.degrees(math.atan2(math.hypot(*scene.gravity[:-1]), -scene.gravity[-1])),
        "speed": max(math.hypot(*body.velocity) for body in scene.bodies),
        "drop": max(body.position[-1] for body in scene.bodies) - scene.lower[-1],
        "gravity": math.hypot(*scene.gravity),
    }
