"""A material point run that stops at every frame, so that somebody may look at its points and push them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.mpm.config import MPMConfig, SimulationError
from gns_pl.mpm.plan import make_plan, make_setting, make_state
from gns_pl.scene import Particles, Scene


class SteppedRun:
    """A run on one thread, from frame to frame.

    Args:
        scene: what is run.
        config: how.
        particles: its points at the start, in the order of all arrays here.
        interval: time between frames [s].
    """

    def __init__(self, scene: Scene, config: MPMConfig, particles: Particles, interval: float) -> None:
        from gns_pl.mpm.grid import make_advance

        self.plan = make_plan(scene, particles, config, interval)
        self._state = make_state(scene, particles, self.plan.grid, config)
        setting = make_setting(scene, self.plan.grid, config, self.plan.dt)
        self._advance = partial(make_advance(config.shape, config.precision, False), *self._state, *setting, 1)

    @property
    def position(self) -> NDArray[np.float64]:
        """Of the points [N, D] [m]."""
        return self.plan.place(self._state[0])

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Of the points [N, D] [m/s]."""
        return np.asarray(self._state[1][:, list(self.plan.grid.axes)], dtype=np.float64)

    def advance(self) -> None:
        """Go on to the next frame.

        Raises:
            SimulationError: points that left the box or became faster than the scene's energy allows.
        """
        left = self._advance(self.plan.steps)
        fastest = float(np.square(self._state[1], dtype=np.float64).sum(axis=1).max()) ** 0.5
        if left or not fastest <= self.plan.speed_limit:
            name = self.plan.scene.name
            raise SimulationError(f"scene {name!r}: points that were pushed left the box or reached {fastest:.3g} m/s.")

    def push(self, velocity: NDArray[Any]) -> None:
        """Add velocities to the points'; their places, stress and affine momentum stay.

        Args:
            velocity: [N, D] [m/s].
        """
        for number, axis in enumerate(self.plan.grid.axes):
            self._state[1][:, axis] += velocity[:, number]
