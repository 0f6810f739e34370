"""How far material goes from where it was released, for any scene: along x for a column, else in every direction."""

from __future__ import annotations

import numpy as np

from gns_pl.metrics.measures import Floats, percentile_front
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory


def is_column(scene: Scene) -> bool:
    """Return whether the laws of the aspect ratio are about a scene.

    It is one body at rest on the floor and at the x- wall, as wide as the box, without obstacles and terrain, under
    gravity that acts along the last axis alone.
    """
    [body, *others] = scene.bodies
    near = 1e-6
    at_wall = abs(body.position[0] - scene.lower[0]) + abs(body.position[-1] - scene.lower[-1]) < near
    spans = all(
        abs(body.position[axis] - scene.lower[axis]) + abs(body.upper[axis] - scene.upper[axis]) < near
        for axis in range(1, scene.dim - 1)
    )
    level = not scene.obstacles and scene.terrain is None
    plain = not others and level and not any(body.velocity) and not any(scene.gravity[:-1])
    return plain and at_wall and spans


def distance_from_bodies(position: Floats, scene: Scene) -> Floats:
    """Return the horizontal distance of particles from the nearest body's ground plan, negative inside [N] [m].

    Args:
        position: [N, D] [m].
        scene: its bodies, where they were released.
    """
    distances = []
    for body in scene.bodies:
        low, high = np.array(body.position[:-1]), np.array(body.upper[:-1])
        beyond = np.maximum(low - position[:, :-1], position[:, :-1] - high)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        distances.append(np.where(outside > 0, outside, beyond.max(axis=1)))
    return np.asarray(np.min(distances, axis=0))


def release_distance(position: Floats, scene: Scene) -> Floats:
    """Return what the front of a scene is measured on: the distance from the x- wall of a column, else from the bodies.

    Args:
        position: [N, D] [m].
        scene: its bodies, where they were released.

    Returns:
        [N] [m].
    """
    return position[:, 0] - scene.lower[0] if is_column(scene) else distance_from_bodies(position, scene)


def front_advance(trajectory: Trajectory) -> Floats:
    """Return the advance of the front within which 99 % of the mass lies, in every frame [T] [m].

    Of a column it is L0 times the curve "runout_99".

    Args:
        trajectory: without kinematic particles (`curves.mobile`).
    """
    distance = np.stack([release_distance(frame.astype(np.float64), trajectory.scene) for frame in trajectory.position])
    front = percentile_front(distance, trajectory.mass.astype(np.float64), (99,), trajectory.spacing)[0]
    return np.asarray(front - front[0])
