"""A material point run that stops at every frame, so that its points may be read and their velocities changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.mpm.config import MPMConfig, SimulationError
from gns_pl.mpm.plan import SAVED, make_plan, make_setting, make_state
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
        self._advance = partial(
            make_advance(config.shape, config.precision, False, config.law, scene.terrain is not None),
            *self._state,
            *setting,
            1,
        )

    @property
    def position(self) -> NDArray[np.float64]:
        """Of the points [N, D] [m]."""
        return self.plan.place(self._state[0])

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Of the points [N, D] [m/s]."""
        return np.asarray(self._state[1][:, list(self.plan.grid.axes)], dtype=np.float64)

    @property
    def stress(self) -> NDArray[np.float64]:
        """Deviator and signed pressure of the points [N, 7] [Pa]: xx, yy, zz, xy, yz, zx, pressure."""
        return np.asarray(self._state[3], dtype=np.float64)

    @stress.setter
    def stress(self, value: NDArray[np.float64]) -> None:
        self._state[3][:] = value

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

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return what `restore` needs to go on from here, to the same bits."""
        return {name: self._state[index].copy() for name, index in SAVED.items()}

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Go on from the state that `saved` returned for a run of the same scene, settings and points."""
        for name, index in SAVED.items():
            self._state[index][:] = saved[name]

    def add_velocity(self, velocity: NDArray[Any]) -> None:
        """Add velocities to those of the points; their positions, stress and affine momentum stay.

        Args:
            velocity: [N, D] [m/s].
        """
        for number, axis in enumerate(self.plan.grid.axes):
            self._state[1][:, axis] += velocity[:, number]


def geostatic_stress(scene: Scene, particles: Particles, load: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the stress of material that carries a load below a level surface, as `SteppedRun.stress` [N, 7] [Pa].

    σ_zz = −load and σ_xx = σ_yy = K σ_zz, with the larger K of two: that of elastic material that cannot spread,
    ν / (1 − ν), and the least that the solver's yield condition √J2 = sin φ p allows, (√3 − sin φ) / (√3 + 2 sin φ).

    Args:
        scene: its materials.
        particles: the points.
        load: what each point carries; negative ones count as none [N] [Pa].
    """
    materials = list(scene.materials.values())
    sine = np.array([math.sin(math.radians(material.friction_angle_deg)) for material in materials])
    elastic = np.array([material.poisson_ratio / (1 - material.poisson_ratio) for material in materials])
    ratio = np.maximum(elastic, (math.sqrt(3) - sine) / (math.sqrt(3) + 2 * sine))[particles.material_name]
    vertical = np.maximum(load, 0.0)
    pressure = vertical * (1 + 2 * ratio) / 3
    across, nothing = pressure - ratio * vertical, np.zeros_like(pressure)
    return np.stack([across, across, pressure - vertical, nothing, nothing, nothing, pressure], axis=1)
