"""What all points of a run do together, in every frame: what is stored beside the few of them that a data set keeps.

Frames come in blocks, and one at a time is in memory in double precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gns_pl.fields import ParticleType
from gns_pl.metrics.curves import mobile
from gns_pl.metrics.maps import volume_map
from gns_pl.metrics.measures import Floats, percentile_front
from gns_pl.metrics.release import release_distance
from gns_pl.trajectory import Observables, Trajectory

PERCENTS = (50.0, 90.0, 99.0, 100.0)
"""Fronts are those behind which so many per cent of the mass lie."""

CELL_SPACINGS = 2
"""Distance of the volume map's nodes, in spacings of the particles that are stored."""


def compute_observables(trajectory: Trajectory, cell: float) -> Observables:
    """Return the observables of every frame of a trajectory; arguments as those of `Observer`."""
    observer = Observer(trajectory, cell)
    observer.add(trajectory.position)
    return observer.observables()


class Observer:
    """Measures the frames of a run as they come.

    Args:
        start: the run or its first frame, for all that does not change; kinematic particles are left out.
        cell: wanted distance of the volume map's nodes [m].
    """

    def __init__(self, start: Trajectory, cell: float) -> None:
        self.moved = start.particle_type != ParticleType.KINEMATIC
        self.start, self.cell = mobile(start), cell
        self.mass, self.volume = (array.astype(np.float64) for array in (self.start.mass, mobile(start).volume()))
        self.before: Floats | None = None
        self.rows: list[tuple[Floats, Floats, float, float]] = []

    def add(self, frames: NDArray[np.floating]) -> None:
        """Measure the next frames [F, N, D] [m]."""
        start, scene = self.start, self.start.scene
        for frame in frames:
            position = frame[self.moved].astype(np.float64)
            velocity = start.initial_velocity if self.before is None else (position - self.before) / start.dt
            front = fronts(release_distance(position, scene), self.mass, PERCENTS, start.spacing)
            height = float(self.mass @ position[:, -1] / self.mass.sum()) - scene.lower[-1]
            energy = float(0.5 * self.mass @ np.square(velocity.astype(np.float64)).sum(axis=1))
            self.rows.append((front, volume_map(position, self.volume, scene, self.cell), height, energy))
            self.before = position

    def observables(self) -> Observables:
        """Return what was measured of all frames."""
        front, maps, height, energy = (np.array(values, dtype=np.float32) for values in zip(*self.rows, strict=True))
        return Observables(PERCENTS, self.cell, front, maps, height, energy)


def fronts(distance: Floats, mass: Floats, percents: tuple[float, ...], width: float) -> Floats:
    """Return `percentile_front` of one frame [len(percents)] [m], in a fraction of its time.

    A front depends on the particles within a width of it; those behind are one mass there, and those beyond another.

    Args:
        distance: [N] [m].
        mass: [N] [kg].
        percents: up to 100.
        width: particle spacing [m].
    """
    order = np.argsort(distance)
    distance, mass = distance[order], mass[order]
    behind = np.cumsum(mass)
    found = np.empty(len(percents))
    for place, percent in enumerate(percents):
        middle = distance[min(int(np.searchsorted(behind, percent / 100 * behind[-1])), len(distance) - 1)]
        first, end = np.searchsorted(distance, [middle - 1.5 * width, middle + 1.5 * width])
        behind_all = behind[first - 1] if first else 0.0
        lumps = ((middle - 10 * width, behind_all), (middle + 10 * width, behind[-1] - behind[end - 1]))
        far = np.array([lump for lump in lumps if lump[1] > 0]).reshape(-1, 2)
        near = np.concatenate([distance[first:end], far[:, 0]])
        weight = np.concatenate([mass[first:end], far[:, 1]])
        found[place] = percentile_front(near[None], weight, (percent,), width)[0, 0]
    return found
