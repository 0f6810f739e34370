"""What decides the error of a solver on a terrain: shares and ratios, by which a scene is like measured ones or not.

Scenes on ground are of all sizes and shapes, so no two are equal. What is compared has no unit, but for the size; a
scene is like measured ones where each of its numbers lies among theirs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from gns_pl.scene import Release, Scene
from gns_pl.scene.extent import characteristic_time, initial_extent

GROUND_SPANS: Mapping[str, tuple[str, str, float, float]] = {
    "ground_slope": ("slope of the ground under the release", "°", 1.1, 1.1),
    "ground_bend": ("change of slope over √(L0 H0)", "", math.inf, 1.25),
    "ground_friction": ("friction of the ground", "", 1.1, 1.1),
    "ground_cells": ("√(L0 H0) over the terrain's cell", "", 1.25, math.inf),
    "friction_angle": ("friction angle", "°", 1.05, 1.05),
    "release_ratio": ("thickness over length of the release", "", 1.25, 1.25),
    "release_size": ("√(L0 H0)", " m", 1.5, 1.5),
    "compression": ("compression by own weight ρ g H / M", "", math.inf, 1.1),
    "cohesion_ratio": ("cohesion over ρ g H", "", math.inf, 1.1),
}
"""Key of a number → its name, unit, and by what factor it may lie below and above all that were measured.

Less bending, compression and cohesion than was measured, and a finer terrain, leave less to err by. The size decides
little by itself: damping of MPM alone has a time of its own."""

BENDS = 95.0
"""Percentile of the changes of slope of a terrain that counts: sharper ones are few and short."""


def ground_setup(scene: Scene) -> dict[str, str | float]:
    """Return what decides the error of a solver on a terrain: texts that must agree, and numbers of `GROUND_SPANS`.

    Args:
        scene: in three dimensions, with a terrain.
    """
    assert scene.terrain is not None
    length, height = initial_extent(scene)
    size, ground = math.sqrt(length * height), scene.terrain
    material = max((scene.materials[body.material] for body in scene.bodies), key=lambda each: each.density)
    weight = material.density * math.hypot(*scene.gravity) * height
    number = len(scene.bodies)
    bodies = f"{number} {'release' if _released(scene) else 'body'}{'s' * (number > 1)}"
    return {
        "bodies": f"{bodies}, {'in motion' if any(any(body.velocity) for body in scene.bodies) else 'at rest'}",
        "materials": f"{len({body.material for body in scene.bodies})} material",
        "obstacles": f"{len(scene.obstacles) or 'no'} obstacle{'s' * (len(scene.obstacles) > 1)}",
        "gravity": "along the last axis" if not any(scene.gravity[:-1]) else "tilted",
        "terrain": ground.wall.condition,
        "ground_slope": _slope(scene),
        "ground_bend": _bend(scene) * size,
        "ground_friction": ground.wall.friction,
        "ground_cells": size / ground.cell,
        "friction_angle": material.friction_angle_deg,
        "release_ratio": height / length,
        "release_size": size,
        "compression": weight / material.oedometric_modulus if weight else 0.0,
        "cohesion_ratio": material.cohesion / weight if weight else 0.0,
        "duration": scene.duration / characteristic_time(scene) if weight else 0.0,
    }


def _released(scene: Scene) -> bool:
    return all(isinstance(body, Release) for body in scene.bodies)


def _slope(scene: Scene) -> float:
    """Return the mean angle of the ground under the bodies [degrees]."""
    assert scene.terrain is not None
    places = []
    for body in scene.bodies:
        low, high = np.array(body.position[:2]), np.array(body.upper[:2])
        spots = low + (np.indices((16, 16)).reshape(2, -1).T + 0.5) / 16 * (high - low)
        under = body.depth(spots) > 0 if isinstance(body, Release) else np.ones(len(spots), dtype=bool)
        places.append(spots[under] if under.any() else spots)
    spots = np.concatenate(places)
    _, normal = scene.terrain.signed_distance(np.column_stack([spots, scene.terrain.height(spots)]))
    return float(np.degrees(np.arccos(np.clip(normal[:, -1], -1.0, 1.0))).mean())


def _bend(scene: Scene) -> float:
    """Return the change of slope over a length that few places of the ground exceed [1/m]."""
    assert scene.terrain is not None
    heights, cell = scene.terrain.heights, scene.terrain.cell
    if min(heights.shape) < 3:
        return 0.0
    bends = [np.abs(np.diff(heights, 2, axis=axis)) for axis in (0, 1)]
    sharpest = np.maximum(bends[0][:, 1:-1], bends[1][1:-1])
    return float(np.percentile(sharpest, BENDS)) / cell**2
