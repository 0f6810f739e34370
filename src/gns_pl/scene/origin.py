"""Scenes far from zero, as those in coordinates of a map, are moved near it, and it is remembered by how much.

Positions are float32, of which a step's displacement is a difference. At 600 km from zero they are 6 cm apart, so the
origin is taken off in float64 where a scene or data come in (`Scene.origin`), and added in float64 where they leave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gns_pl.errors import InputError
from gns_pl.scene.boundaries import Obstacle, Plane
from gns_pl.scene.definition import Body, Scene
from gns_pl.scene.release import Release
from gns_pl.scene.terrain import Terrain

FAR = 4.0
"""A box whose corners are farther from zero than this many of its longest edge is moved: two binary digits are lost."""

COARSE = 0.01
"""Largest distance of two float32 numbers that positions may have, in spacings; ours come to 1e-4."""


def far_origin(lower: Sequence[float], upper: Sequence[float]) -> tuple[float, ...]:
    """Return what is to be taken off coordinates, whole metres along the axes that are far from zero [D] [m].

    Args:
        lower: lower corner of the box [D] [m].
        upper: upper corner of the box [D] [m].
    """
    far = FAR * max(high - low for low, high in zip(lower, upper, strict=True))
    return tuple(
        float(math.floor(low)) if max(abs(low), abs(high)) > far else 0.0
        for low, high in zip(lower, upper, strict=True)
    )


def without_origin(place: Sequence[float], origin: Sequence[float]) -> tuple[float, ...]:
    """Return a place less an origin, to 1e-8 m where one is taken off, so that 600000.1 becomes 0.1 [D] [m]."""
    return tuple(round(value - zero, 8) if zero else value for value, zero in zip(place, origin, strict=True))


def near_origin(scene: Scene) -> Scene:
    """Return a scene moved near zero by whole metres, which its `origin` remembers; as it is where it is not far."""
    origin = far_origin(scene.lower, scene.upper)
    if not any(origin):
        return scene

    def moved(place: Sequence[float]) -> tuple[float, ...]:
        return without_origin(place, origin)

    def moved_obstacle(obstacle: Obstacle) -> Obstacle:
        if isinstance(obstacle, Plane):
            return replace(obstacle, point=moved(obstacle.point))
        return replace(obstacle, position=moved(obstacle.position))

    def moved_body(body: Body) -> Body:
        return body.moved(moved) if isinstance(body, Release) else replace(body, position=moved(body.position))

    def moved_terrain(terrain: Terrain) -> Terrain:
        heights = np.round(terrain.heights - origin[-1], 8) if origin[-1] else terrain.heights
        return terrain.replace(corner=without_origin(terrain.corner, origin[:-1]), heights=heights)

    return scene.replace(
        lower=moved(scene.lower),
        upper=moved(scene.upper),
        bodies=tuple(map(moved_body, scene.bodies)),
        obstacles=tuple(map(moved_obstacle, scene.obstacles)),
        origin=tuple(known + zero for known, zero in zip(scene.origin, origin, strict=True)),
        terrain=None if scene.terrain is None else moved_terrain(scene.terrain),
    )


def float32_distance(coordinate: float) -> float:
    """Return how far two neighbouring float32 numbers are apart at a coordinate."""
    return float(np.spacing(np.float32(abs(coordinate))))


def check_coarseness(owner: str, extent: float, spacing: float, advice: str) -> None:
    """Raise an `InputError` where float32 cannot tell positions apart as far as their motion needs.

    Args:
        owner: whose positions these are, for the message.
        extent: largest coordinate, as a magnitude [m].
        spacing: of the particles [m].
        advice: what to do, a clause.
    """
    apart = float32_distance(extent)
    if apart > COARSE * spacing:
        raise InputError(
            f"{owner}: coordinates reach {extent:.4g} m, where float32 numbers are {apart:.2g} m apart, for particles "
            f"{spacing:.3g} m apart; {advice}."
        )
