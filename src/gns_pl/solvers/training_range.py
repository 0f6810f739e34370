"""Whether a scene is like those that something was trained on: bodies, walls, material, size, shape and motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gns_pl.scene import Material, Scene, Wall, part_from_dict, scene_from_dict


def out_of_range(scene: Scene, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield what of a scene is beyond a data set, in words.

    Args:
        scene: as it is run, so in two dimensions where the data are.
        data: the specification of the data, as in conf/data/.
    """
    families = list(_families(data))
    if not families:
        yield "its data do not say what they hold"
        return
    if scene.obstacles:
        yield "knows no obstacles"
    if scene.terrain is not None:
        yield "takes no terrain (solver=mpm and shallow do)"
    most = max(family.get("bodies", 2 if family.get("kind") == "pair_release" else 1) for family in families)
    if len(scene.bodies) > most:
        known_bodies = "single bodies" if most == 1 else f"up to {most} bodies"
        yield f"trained on {known_bodies}, the scene has {len(scene.bodies)}"
    walls = [{**data.get("walls", {}), **family.get("walls", {})} for family in families]
    known = [{face: part_from_dict(Wall, face, wall) for face, wall in each.items()} for each in walls]
    touched = [face for face in scene.walls if face != "z+"]  # nothing rises to the lid
    if all(any(each.get(face) != scene.walls[face] for face in touched) for each in known):
        seen = {face: {each[face].description for each in known if face in each} for face in touched}
        here = {face: scene.walls[face].description for face in touched}
        other = next((face for face in touched if here[face] not in seen[face]), None)
        # Where each wall occurs by itself, no family has all of them.
        how = "in this combination"
        if other is not None:
            how = f"{other}: {' or '.join(sorted(seen[other])) or 'none'}, here {here[other]}"
        yield f"trained with other walls ({how})"
    gravity, size = float(data.get("gravity", 0.0)), math.hypot(*scene.gravity)
    slope = math.degrees(math.atan2(math.hypot(*scene.gravity[:-1]), -scene.gravity[-1]))
    steepest = max(max(family.get("slope_deg", (0.0,))) for family in families)
    if abs(size - gravity) > 0.01 * gravity or slope > steepest + 0.01:
        tilted = f" on slopes of up to {steepest:g}°" if steepest else " downwards"
        yield f"trained at a gravity of {gravity:g} m/s²{tilted}"
    angles = [each for family in families for each in family.get("friction_angle_deg", ())]
    base = part_from_dict(Material, "material", data["material"])
    materials = [base, *(material for family in families for material in family.get("materials", ()))]
    for body in scene.bodies:
        material = scene.materials[body.material]
        angle = material.friction_angle_deg
        if angles and not min(angles) <= angle <= max(angles):
            yield f"trained on friction angles of {min(angles):g} to {max(angles):g}°"
        other_angle = not angles and angle != base.friction_angle_deg
        if other_angle or all(replace(each, friction_angle_deg=angle) != material for each in materials):
            yield "trained on another material"
        yield from _beyond_shape(scene, body, families)


def _families(data: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the families of a data set; each given scene is one, of the numbers that it has."""
    for family in data.get("families", {}).values():
        if "scenes" not in family:
            if family.get("count", 1):
                yield family
            continue
        for plain in family["scenes"]:
            scene = scene_from_dict(plain)
            bodies = scene.bodies
            yield {
                "walls": plain["walls"],
                "bodies": len(bodies),
                "slope_deg": [math.degrees(math.atan2(math.hypot(*scene.gravity[:-1]), -scene.gravity[-1]))],
                "materials": [scene.materials[body.material] for body in bodies],
                "friction_angle_deg": [scene.materials[body.material].friction_angle_deg for body in bodies],
                "length": [body.size[0] for body in bodies],
                "aspect_ratio": [body.size[-1] / body.size[0] for body in bodies],
                "speed": [abs(component) for body in bodies for component in body.velocity],
                "max_drop": [body.position[-1] - scene.lower[-1] for body in bodies],
            }


def _beyond_shape(scene: Scene, body: Any, families: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield what of a body's size, shape and motion is beyond all families."""
    length, height, speed = body.size[0], body.size[-1], math.hypot(*body.velocity)
    ratio, drop = height / length, body.position[-1] - scene.lower[-1]

    def span(*keys: str) -> tuple[float, float]:
        values = [value for family in families for key in keys for value in np.atleast_1d(family.get(key, []))]
        return (float(min(values)), float(max(values))) if values else (math.nan, math.nan)

    for what, value, (low, high), unit in (
        ("lengths", length, span("length", "side"), " m"),
        ("aspect ratios", ratio, span("aspect_ratio"), ""),
    ):
        if not 0.99 * low <= value <= 1.01 * high:
            yield f"trained on {what} from {low:g} to {high:g}{unit}, not {value:.3g}"
    if speed > 1e-9 + math.sqrt(scene.dim) * span("speed")[1] or (speed and math.isnan(span("speed")[1])):
        yield f"trained on initial speeds up to {span('speed')[1]:g} m/s along an axis"
    if drop > 1e-9 and not drop <= 1.01 * span("max_drop")[1]:
        yield f"trained on drops up to {span('max_drop')[1]:g} m"
