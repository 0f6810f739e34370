"""What has to be beaten before anything else counts: solvers that compute next to nothing.

Two of them give a flow, of the particles that a coarse run would have: `Still`, in which nothing moves, and
`Ballistic`, in which every particle flies on its own and stops where it meets the floor. The others, a law of the
aspect ratio and the extrapolation of two coarse runs, give the runout and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gns_pl.scene import Scene, fill_scene
from gns_pl.scene.extent import frame_interval_of, num_frames
from gns_pl.solvers.solver import Solver, characteristic_size
from gns_pl.trajectory import Trajectory, start_trajectory


@dataclass(frozen=True)
class Still(Solver):
    """Nothing moves.

    Attributes:
        name: of the solver.
        cells: particles stand as two in every one of so many cells per √(L0 H0).
    """

    name: str
    cells: float
    group: str = field(default="trivial", init=False)
    selectable: bool = field(default=False, init=False)

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return that it knows the floor of the box alone, or None."""
        return None if scene.terrain is None else "takes no terrain (solver=ground, mpm and shallow do)"

    def spacing(self, scene: Scene) -> float:
        """Return the distance of neighbouring particles [m]."""
        return characteristic_size(scene) / self.cells / 2

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of particles and of steps."""
        volume = sum(math.prod(body.size) for body in scene.bodies)
        return round(volume / self.spacing(scene) ** scene.dim), 1

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return the trajectory; arguments as those of `Solver.run`."""
        interval = frame_interval_of(scene, interval)
        particles = fill_scene(scene, self.spacing(scene), jitter=0.5, generator=np.random.default_rng(seed))
        start = start_trajectory(scene, particles, interval, {"solver": self.name})
        return self._moved(start, np.arange(num_frames(scene, interval)) * interval)

    def _moved(self, start: Trajectory, time: np.ndarray) -> Trajectory:
        return Trajectory(**{**vars(start), "position": np.repeat(start.position, len(time), axis=0)})


@dataclass(frozen=True)
class Ballistic(Still):
    """Every particle falls freely, and stops where it meets the floor or, sideways, a wall."""

    def _moved(self, start: Trajectory, time: np.ndarray) -> Trajectory:
        scene, place = start.scene, start.position[0].astype(np.float64)
        velocity, gravity = start.initial_velocity.astype(np.float64), np.array(scene.gravity)
        lower, upper = np.array(scene.lower), np.array(scene.upper)
        fall, above = gravity[-1], np.maximum(place[:, -1] - lower[-1], 0.0)
        rise = velocity[:, -1]
        # The later root of above + rise t + fall t² / 2 = 0; without a pull downwards nothing lands.
        landed = np.full(len(place), np.inf)
        if fall < 0:
            landed = (rise + np.sqrt(rise**2 - 2 * fall * above)) / -fall
        elapsed = np.minimum(time[:, None], landed)[..., None]
        position = np.clip(place + velocity * elapsed + 0.5 * gravity * elapsed**2, lower, upper)
        return Trajectory(**{**vars(start), "position": position.astype(np.float32)})


def extrapolate(coarse: float, fine: float, ratio: float, order: float = 1.0) -> float:
    """Return what a number tends to as the cell goes to zero, if its error goes with the cell's power `order`.

    Args:
        coarse: the number on the coarser cells.
        fine: the same on the finer ones.
        ratio: of the cells, coarser over finer, above 1.
        order: of the error; 1 takes the straight line through both.
    """
    return fine + (fine - coarse) / (math.pow(ratio, order) - 1)


@dataclass(frozen=True)
class FittedLaw:
    """A runout law fitted to runs: ln r = c0 + c1 ln a + c2 (ln a)², with fewer terms where there are fewer runs.

    Attributes:
        coefficients: c0, c1, c2.
    """

    coefficients: tuple[float, ...]

    @classmethod
    def to_runs(cls, runouts: Mapping[float, float] | Sequence[tuple[float, float]]) -> FittedLaw:
        """Fit by least squares.

        Args:
            runouts: aspect ratio → final runout [L0], both above 0.
        """
        ratio, runout = np.log(np.array(sorted(dict(runouts).items()))).T
        terms = np.vander(ratio, min(3, len(ratio)), increasing=True)
        found, *_ = np.linalg.lstsq(terms, runout, rcond=None)
        return cls(tuple(float(each) for each in found))

    def __call__(self, aspect_ratio: float) -> float:
        """Return the runout in L0."""
        return math.exp(sum(each * math.log(aspect_ratio) ** power for power, each in enumerate(self.coefficients)))
