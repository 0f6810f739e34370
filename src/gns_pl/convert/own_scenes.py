"""Scenes of our own trajectories on their way into another set: as they are, or scaled and turned with the axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from gns_pl.convert.facts import Facts
from gns_pl.errors import InputError
from gns_pl.scene import FACES, Body, Box, Obstacle, Scene
from gns_pl.scene.origin import without_origin

T = TypeVar("T")


def carried_scene(scene: Scene, facts: Facts) -> Scene:
    """Return the scene of a trajectory, with what the user said of box, gravity, unit of length and axes.

    Args:
        scene: of a trajectory of ours, in its unit of length along its axes.
        facts: of this trajectory (`Facts.of`), in metres along the new axes.

    Raises:
        InputError: a box that leaves out a body.
    """
    if facts.scale == 1 and list(facts.axes) == sorted(facts.axes) and not any(facts.origin):
        return scene.replace(lower=facts.lower, upper=facts.upper, gravity=facts.gravity)
    if scene.terrain is not None:
        raise InputError("its scene has a terrain, which keeps its unit of length, its axes and its origin.")
    return scene.replace(
        lower=facts.lower,
        upper=facts.upper,
        gravity=facts.gravity,
        bodies=tuple(
            replace(body, **_place(body, facts, "position"), **_lengths(body, facts, "size", "velocity"))
            for body in scene.bodies
        ),
        walls=turned_faces(scene.walls, facts.axes),
        obstacles=tuple(_obstacle(obstacle, facts) for obstacle in scene.obstacles),
    )


def _obstacle(obstacle: Obstacle, facts: Facts) -> Obstacle:
    if isinstance(obstacle, Box):
        return replace(obstacle, **_place(obstacle, facts, "position"), **_lengths(obstacle, facts, "size"))
    normal = tuple(obstacle.normal[axis] for axis in facts.axes)
    return replace(obstacle, **_place(obstacle, facts, "point"), normal=normal)


def _place(part: Body | Obstacle, facts: Facts, name: str) -> dict[str, Any]:
    return {name: without_origin(_lengths(part, facts, name)[name], facts.origin)}


def _lengths(part: Body | Obstacle, facts: Facts, *names: str) -> dict[str, Any]:
    return {name: tuple(getattr(part, name)[axis] * facts.scale for axis in facts.axes) for name in names}


def turned_faces(walls: Mapping[str, T], axes: tuple[int, ...]) -> dict[str, T]:
    """Return what belongs to the faces of the box, by the names that the faces have along other axes.

    Args:
        walls: face → anything.
        axes: of the old, in the order of the new.
    """
    faces = FACES[len(axes)]
    return {faces[2 * new + side]: walls[faces[2 * old + side]] for new, old in enumerate(axes) for side in (0, 1)}
