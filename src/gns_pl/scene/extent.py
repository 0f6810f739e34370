"""The scales of a scene: how long and how high its bodies are together, and how long a collapse of them takes."""

from __future__ import annotations

import math

from gns_pl.errors import InputError
from gns_pl.scene.definition import Scene


def initial_extent(scene: Scene) -> tuple[float, float]:
    """Return the initial length L0 along x and height H0 along the last axis of all bodies together [m].

    For a column against the x = lower wall these are its edges, and H0 / L0 its aspect ratio a.
    """
    extent = [
        max(body.upper[axis] for body in scene.bodies) - min(body.position[axis] for body in scene.bodies)
        for axis in (0, scene.dim - 1)
    ]
    return extent[0], extent[1]


def characteristic_time(scene: Scene) -> float:
    """Return τc = √(H0 / g) [s], the time scale of a collapse (Lube et al. 2005; Lajeunesse et al. 2005).

    Raises:
        InputError: a scene without gravity.
    """
    gravity = math.hypot(*scene.gravity)
    if gravity == 0:
        raise InputError(f"scene {scene.name!r}: it has no gravity, so a collapse has no characteristic time.")
    return math.sqrt(initial_extent(scene)[1] / gravity)
