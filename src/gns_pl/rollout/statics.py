"""Whether what begins at rest is a heap that stays at rest: statics, before any step is made.

A network has no static friction. Of a deposit it moves every grain a little in the first steps, and lets faces slide
that rest; docs/stability.md has how far. A heap that nowhere is steeper than friction holds does not move.
"""

from __future__ import annotations

import math

import numpy as np

from gns_pl.fields import ParticleType
from gns_pl.trajectory import Trajectory

CELL = 2.0
"""Edge of the cells in which the height of a heap is looked at [spacings]."""

REACH = 4
"""Cells that two of them are apart, at most, when the slope from one to the other is."""

ROUGH = 1.0
"""By so much single grains may stand out over a slope [spacings]; deposits of the material point method do by 0.9."""

HOLLOW, HOLLOW_MEAN = 2.5, 1.0
"""Height that may be empty below the surface, in a cell and as a mean [spacings]; at their thin ends deposits of the
material point method have up to 2.3."""


def is_resting_heap(start: Trajectory) -> bool:
    """Return whether the first frame of a trajectory is a heap at rest on the floor of its box, and stays one.

    Nothing has a velocity or a script; gravity is normal to the floor; there is neither an obstacle nor a terrain;
    below the surface no height is empty; and no two places of the surface are joined by a line that is steeper than
    `steepest_slope`. Cohesion, which holds more, is left out.

    Args:
        start: its first frame, types, initial velocities and scene.
    """
    scene, spacing = start.scene, start.spacing
    if any(scene.gravity[:-1]) or scene.gravity[-1] >= 0 or scene.obstacles or scene.terrain is not None:
        return False
    if start.initial_velocity.any() or (start.particle_type == int(ParticleType.KINEMATIC)).any():
        return False
    position = start.position[0].astype(np.float64) - scene.lower
    size = np.subtract(scene.upper, scene.lower)[:-1]
    cells = np.maximum(1, (size / (CELL * spacing) + 1e-6).astype(int))
    cell = size / cells
    place = tuple(np.clip((position[:, :-1] / cell).astype(int), 0, cells - 1).T)
    surface, filled = np.zeros(cells), np.zeros(cells)
    np.maximum.at(surface, place, position[:, -1] + spacing / 2)
    np.add.at(filled, place, start.volume() / cell.prod())
    hollow = (surface - filled)[surface > 0] / spacing
    if not (hollow.max() <= HOLLOW and hollow.mean() <= HOLLOW_MEAN):
        return False
    angle = min(scene.materials[body.material].friction_angle_deg for body in scene.bodies)
    floor = scene.walls["z-"]
    slope = steepest_slope(angle, {"slip": 0.0, "stick": math.inf}.get(floor.condition, floor.friction))
    around = np.pad(surface, REACH, constant_values=-np.inf)  # no place is beyond a wall
    for shift in np.ndindex(*(2 * REACH + 1,) * len(cells)):
        there = around[tuple(slice(begin, begin + count) for begin, count in zip(shift, cells, strict=True))]
        distance = float(np.linalg.norm((np.array(shift) - REACH) * cell))
        if (there - surface).max() > slope * distance + ROUGH * spacing:
            return False
    return True


def steepest_slope(friction_angle_deg: float, floor_friction: float) -> float:
    """Return the tangent of the steepest slope at which a heap without cohesion rests on a floor.

    Grains rest on a slope up to tan φ. A layer of depth h rests on the floor while the thrust K ρ g h |∂h/∂x| is no
    more than the friction m ρ g h below it, for some m up to the floor's coefficient; K(m) is the active coefficient of
    earth pressure of Savage and Hutter (1989), without friction that of Rankine.

    Args:
        friction_angle_deg: angle of internal friction φ [degrees].
        floor_friction: coefficient of the floor.
    """
    angle = math.radians(friction_angle_deg)
    square, internal = math.cos(angle) ** 2, math.tan(angle)
    mobilised = np.linspace(0.0, min(floor_friction, internal), 100)
    root = np.sqrt(np.maximum(1 - square * (1 + np.square(mobilised)), 0.0))
    pressure = 2 * (1 - root) / square - 1
    return min(internal, float((mobilised / pressure).max()))
