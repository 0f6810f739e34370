"""Whether a run's momentum is accounted for: gravity, and what walls that are touched can give."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory

DIRECTIONS = 8
"""Of friction in three dimensions: the cone of a wall becomes a pyramid of so many edges, 7.6 % narrow at worst."""

STICK = 100.0
"""Coefficient of friction of a wall that holds whatever touches it."""


def momentum_residual(trajectory: Trajectory, reach: float) -> NDArray[np.float64]:
    """Return what of the centre of mass' acceleration neither gravity nor any wall can explain, over g [T − 2].

    A wall with particles within `reach` may push inwards by any n ≥ 0 and along itself by up to μ n (Coulomb), so all
    walls together give a cone of accelerations; the residual is the distance of a − g from it. It is 0 in free fall if
    that is exact, and whatever happens inside of the material, collisions of bodies included. The centre of mass is
    differenced twice, so that frame k belongs to t_{k+1}.

    Args:
        trajectory: [T, N, D].
        reach: of a wall [m].
    """
    scene, gravity = trajectory.scene, np.array(trajectory.scene.gravity)
    mass = trajectory.mass.astype(np.float64)
    position = trajectory.position.astype(np.float64)
    centre = np.einsum("tnd,n->td", position, mass) / mass.sum()
    force = (centre[2:] - 2 * centre[1:-1] + centre[:-2]) / trajectory.dt**2 - gravity
    low = position.min(axis=1) - np.array(scene.lower) < reach
    high = np.array(scene.upper) - position.max(axis=1) < reach
    residual = np.empty(len(force))
    for frame, wanted in enumerate(force):
        near = (slice(frame, frame + 3),)
        edges = _cone(scene, low[near].any(axis=0), high[near].any(axis=0))
        residual[frame] = nnls(edges, wanted)[1] if edges.shape[1] else np.linalg.norm(wanted)
    return residual / math.hypot(*scene.gravity)


def _cone(scene: Scene, low: NDArray[np.bool_], high: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the edges of the cone of forces that walls can give [D, number]."""
    edges = []
    axes = "xz" if scene.dim == 2 else "xyz"
    for axis, letter in enumerate(axes):
        for touched, side, sign in ((low, "-", 1.0), (high, "+", -1.0)):
            if not touched[axis]:
                continue
            wall = scene.walls[letter + side]
            friction = {"slip": 0.0, "stick": STICK}.get(wall.condition, wall.friction)
            normal = np.zeros(scene.dim)
            normal[axis] = sign
            along = [other for other in range(scene.dim) if other != axis]
            for turn in np.arange(2 if scene.dim == 2 else DIRECTIONS) * 2 * math.pi:
                edge = normal.copy()
                angle = turn / (2 if scene.dim == 2 else DIRECTIONS)
                edge[along] = friction * np.array([math.cos(angle), math.sin(angle)])[: len(along)]
                edges.append(edge)
    return np.array(edges).T if edges else np.empty((scene.dim, 0))
