"""A scene with other friction or another release, as an ensemble of runs varies it, and which values it takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from gns_pl.errors import InputError
from gns_pl.scene.boundaries import WALL_CONDITIONS, Obstacle, Wall
from gns_pl.scene.checks import checked_number
from gns_pl.scene.definition import Body, Scene
from gns_pl.scene.raster import Raster
from gns_pl.scene.release import Release, make_release


def with_friction_angle(scene: Scene, angle_deg: float) -> Scene:
    """Return a scene whose bodies all have an angle of internal friction [degrees]."""
    used = {body.material for body in scene.bodies}
    materials = {
        name: replace(material, friction_angle_deg=angle_deg) if name in used else material
        for name, material in scene.materials.items()
    }
    return scene.replace(materials=materials)


def with_ground_friction(scene: Scene, coefficient: float) -> Scene:
    """Return a scene whose floor, obstacles and terrain have a coefficient of friction, as far as they have any.

    Raises:
        InputError: none of them has.
    """

    def rough(wall: Wall) -> Wall:
        return replace(wall, friction=coefficient) if WALL_CONDITIONS[wall.condition] else wall

    def rough_obstacle(obstacle: Obstacle) -> Obstacle:
        return replace(obstacle, wall=rough(obstacle.wall))

    walls = {**scene.walls, "z-": rough(scene.walls["z-"])}
    terrain = scene.terrain and scene.terrain.replace(wall=rough(scene.terrain.wall))
    changed = scene.replace(walls=walls, obstacles=tuple(map(rough_obstacle, scene.obstacles)), terrain=terrain)
    grounds = [scene.walls["z-"], *(each.wall for each in scene.obstacles)]
    grounds += [scene.terrain.wall] if scene.terrain else []
    if not any(WALL_CONDITIONS[wall.condition] for wall in grounds):
        raise InputError(
            f"ground_friction: nothing that scene {scene.name!r} stands on has a coefficient; give its floor or its "
            "terrain the condition friction."
        )
    return changed


def with_release(scene: Scene, factor: float) -> Scene:
    """Return a scene whose bodies are so many times as thick, on the same ground plan: as many times the volume."""
    checked_number("ensemble", "release", factor, 0.0, above=True)

    def thicker(body: Body) -> Body:
        if isinstance(body, Release) and scene.terrain is not None:
            thickness = body.thickness
            if isinstance(thickness, Raster):
                more: float | Raster = replace(thickness, values=factor * thickness.values)
            else:
                more = factor * thickness
            return make_release(
                scene.terrain, thickness=more, outline=body.outline, velocity=body.velocity, material=body.material
            )
        return replace(body, size=(*body.size[:-1], factor * body.size[-1]))

    return scene.replace(bodies=tuple(map(thicker, scene.bodies)))


VARIATIONS: dict[str, Callable[[Scene, float], Scene]] = {
    "friction_angle_deg": with_friction_angle,
    "ground_friction": with_ground_friction,
    "release": with_release,
}
"""Name → what makes a scene of a scene and a value. Any key of a scene file can be varied besides."""


def drawn_values(bands: Mapping[str, tuple[float, float]], number: int, seed: int) -> list[dict[str, float]]:
    """Return values evenly spread over bands; a larger number begins with those of a smaller one.

    Halton's sequence, scrambled (Owen 2017, A randomized Halton algorithm in R; `scipy.stats.qmc.Halton`).

    Args:
        bands: name → least and largest value.
        number: of draws.
        seed: of the scrambling.
    """
    from scipy.stats.qmc import Halton

    points = Halton(len(bands), scramble=True, seed=seed).random(number)
    low, high = np.array(list(bands.values())).T
    return [dict(zip(bands, map(float, values), strict=True)) for values in low + points * (high - low)]


def grid_values(bands: Mapping[str, tuple[float, float]], number: int) -> list[dict[str, float]]:
    """Return all combinations of values at equal distances, both ends of every band among them.

    Args:
        bands: name → least and largest value.
        number: of values of each.
    """
    lines = [np.linspace(low, high, number).tolist() for low, high in bands.values()]
    return [dict(zip(bands, values, strict=True)) for values in product(*lines)]
