"""Whether a scene is like those that something was trained on: bodies, walls, material, size, shape and motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gns_pl.scene import Box, Material, Plane, Scene, Wall, part_from_dict, scene_from_dict
from gns_pl.scene.ground_release import ground_limits


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
    grounds = [family for family in families if family.get("kind") == "ground_release"]
    yield from _beyond_ground(scene, grounds)
    most = max(family.get("bodies", 2 if family.get("kind") == "pair_release" else 1) for family in families)
    if len(scene.bodies) > most:
        known_bodies = "single bodies" if most == 1 else f"up to {most} bodies"
        yield f"trained on {known_bodies}, the scene has {len(scene.bodies)}"
    walls = [] if grounds else [{**data.get("walls", {}), **family.get("walls", {})} for family in families]
    known = [{face: part_from_dict(Wall, face, wall) for face, wall in each.items()} for each in walls]
    touched = [face for face in scene.walls if face != "z+"]  # nothing rises to the lid
    if known and all(any(each.get(face) != scene.walls[face] for face in touched) for each in known):
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


def size_range(data: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the least and the largest √(L0 H0) of the bodies of a data set [m]; None where it does not say."""
    sizes: list[float] = []
    for family in _families(data):
        for pick in (min, max):
            if "side" in family:
                sizes.append(pick(family["side"]))
            elif "length" in family and ("height" in family or "aspect_ratio" in family):
                length = pick(family["length"])
                height = pick(family["height"]) if "height" in family else length * pick(family["aspect_ratio"])
                sizes.append(math.sqrt(length * height))
    return (min(sizes), max(sizes)) if sizes else None


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


def _beyond_ground(scene: Scene, grounds: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield what of obstacles, terrain and friction is beyond all families of releases on ground."""
    if not grounds:
        if scene.obstacles:
            yield "knows no obstacles"
        if scene.terrain is not None:
            yield "takes no terrain (solver=ground, mpm and shallow do)"
        return
    cuboids = any(isinstance(obstacle, Box) for obstacle in scene.obstacles)
    if cuboids and not any(family.get("barrier", 0) or family.get("step", 0) for family in grounds):
        yield "trained without steps and barriers"
    limits = [ground_limits(family) for family in grounds]
    steepest, roughest = (max(values) for values in zip(*limits, strict=True))
    steep, rough = _shape_of_ground(scene)
    if steep > 1.01 * steepest:
        yield f"trained on ground of up to {steepest:.0f}°, not {steep:.0f}°"
    if rough > 1.01 * roughest:
        yield f"trained on ground whose slope changes by up to {roughest:.2g} in a metre, not {rough:.2g}"
    walls = [wall for face, wall in scene.walls.items() if face not in ("z-", "z+")]
    floor = scene.walls["z-"] if scene.terrain is None else scene.terrain.wall
    rigid = [*(wall for wall in walls if wall.condition != "slip"), floor, *(each.wall for each in scene.obstacles)]
    low, high = (pick(each for family in grounds for each in family["friction"]) for pick in (min, max))
    for wall in rigid:
        if wall.condition != "friction" or not 0.99 * low <= wall.friction <= 1.01 * high:
            yield f"trained on ground and walls of friction {low:g} to {high:g}, not {wall.description}"
            return


def _shape_of_ground(scene: Scene) -> tuple[float, float]:
    """Return the steepest slope of terrain and planes [degrees], and the terrain's largest change of slope [1/m]."""
    flat = [abs(obstacle.normal[-1]) for obstacle in scene.obstacles if isinstance(obstacle, Plane)]
    steep, rough = max((math.degrees(math.acos(min(1.0, each))) for each in flat), default=0.0), 0.0
    if scene.terrain is not None:
        terrain = scene.terrain.cropped(scene.lower[:-1], scene.upper[:-1])
        slopes = np.gradient(terrain.heights, terrain.cell)
        slopes = [slopes] if scene.dim == 2 else slopes
        steep = max(steep, math.degrees(math.atan(float(np.sqrt(sum(np.square(each) for each in slopes)).max()))))
        bends = [np.abs(np.diff(terrain.heights, 2, axis=axis)).max(initial=0.0) for axis in range(scene.dim - 1)]
        rough = float(max(bends)) / terrain.cell**2
    return steep, rough


def _ground_below(scene: Scene, body: Any) -> tuple[float, float]:
    """Return the least and the largest height of the terrain, or of a floor or a cuboid's top, below a body [m]."""
    places = np.stack(
        np.meshgrid(*(np.linspace(*ends, 9) for ends in zip(body.position[:-1], body.upper[:-1], strict=True))), -1
    )
    ground = np.full(9, scene.lower[-1])
    if scene.terrain is not None:
        ground = np.maximum(scene.terrain.height(places.reshape(-1, scene.dim - 1)), scene.lower[-1])
    tops = [
        obstacle.upper[-1]
        for obstacle in scene.obstacles
        if isinstance(obstacle, Box)
        and all(
            low < end and start < high
            for low, high, start, end in zip(
                obstacle.position[:-1], obstacle.upper[:-1], body.position[:-1], body.upper[:-1], strict=True
            )
        )
        and obstacle.upper[-1] <= body.position[-1] + 1e-9
    ]
    return max([float(ground.min()), *tops]), max([float(ground.max()), *tops])


def _ratios(family: Mapping[str, Any]) -> tuple[float, float]:
    """Return the lowest and the highest height over length of a family of releases on ground."""
    (low, high), (short, long) = family["height"], family["length"]
    return low / long, high / short


def _beyond_shape(scene: Scene, body: Any, families: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield what of a body's size, shape and motion is beyond all families."""
    low, high = _ground_below(scene, body)
    length, speed = body.size[0], math.hypot(*body.velocity)
    ratio, drop = (body.upper[-1] - max(high, body.position[-1])) / length, body.position[-1] - high

    def span(*keys: str) -> tuple[float, float]:
        values = [value for family in families for key in keys for value in np.atleast_1d(family.get(key, []))]
        if keys == ("aspect_ratio",):  # releases on ground have a height over it
            grounds = [family for family in families if family.get("kind") == "ground_release"]
            values += [ratio for family in grounds for ratio in _ratios(family)]
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
