"""What of a deposit coarse MPM is fitted to: how far it reached, how high it lies, and where it lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gns_pl.metrics.measures import Floats, centre_of_mass, particle_spacing, percentile_front
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class Observed:
    """A final deposit.

    Attributes:
        front: distance from the bodies' footprints within which 99 % of the mass lies [m].
        height: mass-weighted mean height over the floor [m].
        volume: in every column of the grid [X, Y] or [X] [m³ or m²].
    """

    front: float
    height: float
    volume: Floats


def observe(trajectory: Trajectory, cell: float) -> Observed:
    """Return what is observed of the last frame.

    Args:
        trajectory: finite in its last frame.
        cell: edge of the grid's columns [m].
    """
    last, scene = trajectory.position[-1].astype(np.float64), trajectory.scene
    distance = distance_from_release(last, scene)
    front = percentile_front(distance[None], trajectory.mass.astype(np.float64), (99,), particle_spacing(trajectory))
    volume = volume_map(last, trajectory.volume().astype(np.float64), scene, cell)
    return Observed(float(front[0, 0]), float(centre_of_mass(trajectory)[-1, -1]), volume)


def distance_from_release(position: Floats, scene: Scene) -> Floats:
    """Return the horizontal distance of particles from the nearest footprint of a body, 0 within one [N] [m].

    Args:
        position: [N, D] [m].
        scene: whose bodies.
    """
    place = position[:, :-1]
    beyond = [np.maximum(0.0, np.maximum(body.position[:-1] - place, place - body.upper[:-1])) for body in scene.bodies]
    return np.asarray(np.min([np.linalg.norm(each, axis=1) for each in beyond], axis=0))


def volume_map(position: Floats, volume: Floats, scene: Scene, cell: float) -> Floats:
    """Return the volume over every cell of a horizontal grid, particles spread over their own width [X, Y] or [X].

    Its sum is the volume of all particles.

    Args:
        position: [N, D] [m].
        volume: of every particle [N] [m^D].
        scene: for the box; what is outside counts to the cells at its edge.
        cell: wanted edge of a cell [m]; each axis takes the nearest size that divides the box.
    """
    dim = position.shape[1]
    width = volume ** (1 / dim)
    index, shares = np.zeros((len(position), 1), dtype=np.int64), np.ones((len(position), 1))
    shape = []
    for axis in range(dim - 1):
        length = scene.upper[axis] - scene.lower[axis]
        number = max(1, round(length / cell))
        edge = length / number
        left = (position[:, axis] - scene.lower[axis] - width / 2) / edge
        reach = int(np.ceil(width.max() / edge)) + 1
        first = np.floor(left).astype(np.int64)[:, None] + np.arange(reach)
        right = (left + width / edge)[:, None]
        covered = np.maximum(0.0, np.minimum(first + 1, right) - np.maximum(first, left[:, None]))
        place = np.clip(first, 0, number - 1)
        index = (index[:, :, None] * number + place[:, None, :]).reshape(len(position), -1)
        shares = (shares[:, :, None] * (covered * edge / width[:, None])[:, None, :]).reshape(len(position), -1)
        shape.append(number)
    total = np.bincount(index.ravel(), (shares * volume[:, None]).ravel(), minlength=int(np.prod(shape)))
    return np.asarray(total.reshape(shape), dtype=np.float64)


def errors(observed: Observed, reference: Observed) -> Floats:
    """Return the relative errors of front and mean height, and the part of the volume that is misplaced [3]."""
    misplaced = np.abs(observed.volume - reference.volume).sum() / (2 * reference.volume.sum())
    return np.array([observed.front / reference.front - 1, observed.height / reference.height - 1, misplaced])
