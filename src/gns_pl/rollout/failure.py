"""When a run has failed: five unphysical states, checked frame by frame.

They are the same for the material point method and for learned simulators, need no reference, and stop a rollout with
a message before it diverges. A run that meets none may still be wrong: its distance from the training data
(docs/trust.md) and a run of MPM tell more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.fields import ParticleType
from gns_pl.scene import Scene
from gns_pl.scene.boundaries import signed_distance
from gns_pl.trajectory import Trajectory, nearest_neighbour_distance

KINDS = ("not finite", "speed", "penetration", "clumping", "energy", "stopped")
"""The last is for a solver that stopped by itself."""

SPEED = 1.5
"""Of √(2 g H), H the way that the highest particle can fall in the box, and the largest initial speed added to it."""
OUTSIDE, OUTSIDE_SHARE = 0.5, 0.001
"""Spacings outside of the box or inside an obstacle, and the share of the particles that must be there."""
CLOSE, CLOSE_SHARE = 0.1, 0.02
"""Of the median distance of nearest neighbours at the start, and the share of the particles that must be nearer.
Material points crowd by themselves: in seven of ten of the data's trajectories that were looked at (every sixth) more
than 1 % come nearer than 0.3, which would call the teacher a failure; nearer than 0.1 come 1.2 % at most, of every
fourth."""
CROWDED = 0.3
"""Told beside it, as a share, and no failure."""
ENERGY = 0.01
"""Of the energy at the start, over the lowest corner of the box."""


@dataclass(frozen=True)
class Failure:
    """The first condition that a run met.

    Attributes:
        kind: one of `KINDS`.
        time: of the frame [s].
        message: what was seen, and the limit.
    """

    kind: str
    time: float
    message: str


class Watch:
    """Looks at the frames of a run in their order.

    Energy is that of motion and height, Σ m (v²/2 − g · x) with v between two frames and x in their middle, so that
    free fall keeps it exactly. It may not rise by more than `ENERGY` over the least that it had before (elastic energy
    stays below that: none of those trajectories rises by 0.1 %); where kinematic particles move, it is not looked at.

    Args:
        start: first frame, masses, types, initial velocities and scene of the run.
        dt: between frames [s].
        before: the frame from which the run goes on, if that is not the first [N, D] [m].
        made: its number.
        every: only every so many-th frame is looked at, which costs a small scene a tenth of its time if all are.

    Attributes:
        failure: what was met first; None as long as nothing is.
        energy: of every frame looked at [J].
        rise: largest rise of the energy so far, over that at the start.
        crowded: largest share of particles nearer than `CROWDED` to another.
    """

    def __init__(
        self,
        start: Trajectory,
        dt: float,
        *,
        before: NDArray[np.floating] | None = None,
        made: int = 0,
        every: int = 1,
    ) -> None:
        scene, first = start.scene, start.position[0].astype(np.float64)
        self.failure: Failure | None = None
        self._scene, self._dt, self._frame, self._every = scene, dt, made, every
        self._gravity, self._mass = np.array(scene.gravity), start.mass.astype(np.float64)
        corner = np.where(self._gravity > 0, scene.upper, scene.lower)  # the lowest of the box
        self._lowest = corner
        fall = float(((corner - first) @ self._gravity).max())
        initial = float(np.linalg.norm(start.initial_velocity, axis=1).max())
        self.speed_limit = SPEED * math.sqrt(2 * max(fall, 0.0)) + initial
        self._nearest = float(np.median(nearest_neighbour_distance(first))) if len(first) > 1 else 0.0
        self._spacing = start.spacing
        self._moved = start.particle_type != int(ParticleType.KINEMATIC)
        velocity = start.initial_velocity.astype(np.float64)
        self._scale = self._total(velocity, first)
        self.energy = [self._scale]
        self._least = max(
            self._scale, self._total(velocity, first - velocity * dt / 2)
        )  # where the next one's middle is
        self.rise = self.crowded = 0.0
        self._before: NDArray[np.floating] = first if before is None else before

    def _total(self, velocity: NDArray[np.float64], position: NDArray[np.float64]) -> float:
        height = (self._lowest - position) @ self._gravity
        return float(self._mass @ (0.5 * np.square(velocity).sum(axis=1) + height))

    @property
    def due(self) -> bool:
        """Whether the next frame is needed: it is looked at, or the one after it is."""
        return (self._frame + 1) % self._every in (0, self._every - 1)

    def skip(self) -> None:
        """Pass over the next frame, which is not `due`."""
        self._frame += 1

    def look(self, position: NDArray[np.floating]) -> Failure | None:
        """Return what is wrong with the next frame, or was with an earlier one; None if nothing.

        Args:
            position: [N, D] [m].
        """
        if self.failure is not None:
            return self.failure
        self._frame += 1
        if self._frame % self._every:
            self._before = position
            return None
        current = np.asarray(position, dtype=np.float64)
        problem = self._first(current)
        if problem is not None:
            time = self._frame * self._dt
            self.failure = Failure(problem[0], time, f"{problem[1]} at {time:.3g} s")
        self._before = current
        return self.failure

    def _first(self, position: NDArray[np.float64]) -> tuple[str, str] | None:
        if not np.isfinite(position).all():
            return "not finite", "positions were no longer finite"
        velocity = (position - self._before) / self._dt
        fastest = float(np.linalg.norm(velocity[self._moved], axis=1).max())
        if fastest > self.speed_limit:
            return "speed", f"a particle reached {fastest:.3g} m/s, where falling gives at most {self.speed_limit:.3g},"
        outside = float((_depth(position, self._scene) > OUTSIDE * self._spacing).mean())
        if outside > OUTSIDE_SHARE:
            return "penetration", f"{100 * outside:.2g} % of the particles were in a wall"
        if self._nearest:
            nearest = nearest_neighbour_distance(position) / self._nearest
            self.crowded = max(self.crowded, float((nearest < CROWDED).mean()))
            close = float((nearest < CLOSE).mean())
            if close > CLOSE_SHARE:
                return "clumping", f"{100 * close:.2g} % of the particles lay on top of another"
        return self._energy_rise(velocity, position)

    def _energy_rise(self, velocity: NDArray[np.float64], position: NDArray[np.float64]) -> tuple[str, str] | None:
        energy = self._total(velocity, (position + self._before) / 2)
        self.energy.append(energy)
        self._least = min(self._least, energy)
        if not (self._scale > 0 and self._moved.all()):
            return None
        rise = (energy - self._least) / self._scale
        self.rise = max(self.rise, rise)
        return ("energy", f"the energy had risen by {100 * rise:.2g} %") if rise > ENERGY else None


def first_failure(trajectory: Trajectory) -> Failure | None:
    """Return the first failure of a whole trajectory; None if there is none."""
    watch = Watch(trajectory, trajectory.dt)
    for position in trajectory.position[1:]:
        if watch.look(position) is not None:
            break
    return watch.failure


def _depth(position: NDArray[np.float64], scene: Scene) -> NDArray[np.float64]:
    """Return how deep particles are in a wall, an obstacle or the ground, 0 outside of all [N] [m]."""
    depth = np.maximum(np.array(scene.lower) - position, position - np.array(scene.upper)).max(axis=1)
    for obstacle in scene.obstacles:
        depth = np.maximum(depth, -signed_distance(obstacle, position)[0])
    if scene.terrain is not None:
        depth = np.maximum(depth, -scene.terrain.signed_distance(position)[0])
    return np.asarray(np.maximum(depth, 0.0))
