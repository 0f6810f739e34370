"""Depth-averaged flow as a solver: cells are a part of the bodies' size, slices and halves are taken."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import gns_pl
from gns_pl.errors import InputError
from gns_pl.scene import Scene
from gns_pl.scene.extent import frame_interval_of
from gns_pl.shallow import ShallowConfig, simulate, unsupported_reason
from gns_pl.solvers.fitted import Factors, FittedSolver
from gns_pl.solvers.reduction import Reduction, reduce_scene
from gns_pl.solvers.solver import Solver, characteristic_size, hashed
from gns_pl.trajectory import Trajectory

AT_REST = "at_rest"
"""In the place of an earth pressure: 1 − sin φ, that of ground at rest (Jaky 1944)."""

LEAVES_OUT = (
    "motion within the layer and along the vertical, lift-off from the ground, pressure other than that of the weight "
    "above, and obstacles inside the flow but for steps of the floor; solver=mpm has them"
)
"""What a layer of one velocity has no variables for."""

LEAST_PARTICLES = 1024
"""Particles that show a layer, at least; otherwise two to a cell and direction."""


@dataclass(frozen=True)
class ShallowSolver(Solver):
    """Depth-averaged granular flow.

    Attributes:
        name: of the solver.
        cells: over √(L0 H0).
        settings: of `ShallowConfig` but for the cells; "earth_pressure" may be `AT_REST`.
    """

    name: str
    cells: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    group: str = field(default="shallow", init=False)
    leaves_out: str = field(default=LEAVES_OUT, init=False, repr=False)

    def __post_init__(self) -> None:
        self._config(1.0, 0.5)  # refuses settings that cannot be

    def _config(self, cell_size: float, at_rest: float) -> ShallowConfig:
        settings = dict(self.settings)
        if settings.get("earth_pressure") == AT_REST:
            settings["earth_pressure"] = at_rest
        try:
            return ShallowConfig(cell_size=cell_size, **settings)
        except TypeError as error:
            raise InputError(f"choice.shallow.{self.name}: {error}.") from error

    def cell_size(self, scene: Scene) -> float:
        """Return the edge of a cell: that of the terrain, which knows nothing finer, or a part of the bodies' [m]."""
        return characteristic_size(scene) / self.cells if scene.terrain is None else scene.terrain.cell

    def config(self, scene: Scene) -> ShallowConfig:
        """Return the settings for a scene."""
        angle = max(scene.materials[body.material].friction_angle_deg for body in scene.bodies)
        cell, reduced_scene = self.cell_size(scene), reduce_scene(scene).scene
        config = self._config(cell, 1 - math.sin(math.radians(angle)))
        if config.num_particles is None:
            volume = sum(body.volume for body in reduced_scene.bodies)
            number = max(LEAST_PARTICLES, round(volume / (cell / 2) ** reduced_scene.dim))
            config = replace(config, num_particles=number)
        return config

    def identity(self) -> str:
        """Return a hash of settings and version."""
        return hashed([self.cells, dict(self.settings), gns_pl.__version__])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return name, version and settings."""
        return {"solver": self.name, "version": gns_pl.__version__, "shallow": vars(self.config(scene))}

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return what of a scene a layer of one thickness and velocity cannot show, or None."""
        reduced_scene = reduce_scene(scene).scene
        if self.settings.get("earth_pressure") == AT_REST:
            angles = {scene.materials[body.material].friction_angle_deg for body in scene.bodies}
            if len(angles) > 1:
                return "depth-averaged flow has one earth pressure, and the bodies have several friction angles."
        return unsupported_reason(reduced_scene)

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice, half, or the scene itself.

        Raises:
            InputError: it cannot be run at all.
        """
        reason = self.unsupported_reason(scene)
        if reason is not None:
            raise InputError(f"scene {scene.name!r}: {reason}")
        return reduce_scene(scene)

    def cost(self, scene: Scene) -> float:
        """Return the number of cells × the number of steps, of waves on the highest body and falls on a terrain."""
        reduced_scene = self.reduced(scene).scene
        cell = self.cell_size(scene)
        lengths = [high - low for low, high in zip(reduced_scene.lower, reduced_scene.upper, strict=True)][:-1]
        gravity, height = math.hypot(*scene.gravity), max(body.upper[-1] for body in reduced_scene.bodies)
        if scene.terrain is None:
            wave = math.sqrt(gravity * (height - reduced_scene.lower[-1]))
        else:  # what slides is faster than its waves
            thickest = max(body.height for body in scene.bodies)
            wave = math.sqrt(gravity * thickest) + math.sqrt(2 * gravity * (height - scene.terrain.heights.min()))
        return math.prod(length / cell for length in lengths) * max(1.0, scene.duration * wave / cell)

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return the trajectory, whose particles show the layer; arguments as those of `Solver.run`."""
        reduction, began = self.reduced(scene), time.perf_counter()
        interval = frame_interval_of(scene, interval)
        trajectory = simulate(reduction.scene, self.config(scene), frame_interval=interval, seed=seed)
        seconds = time.perf_counter() - began
        provenance = {**trajectory.provenance, **self.facts(scene), "seed": seed, "wall_seconds": seconds}
        return reduction.lift(replace(trajectory, provenance=provenance))


@dataclass(frozen=True)
class ShallowFactors(Factors):
    """By what depth-averaged flow changes its own scalars.

    Attributes:
        earth_pressure: on the horizontal earth pressure k of the settings.
        floor_friction: on tan δ of every floor.
    """

    earth_pressure: float = 1.0
    floor_friction: float = 1.0


@dataclass(frozen=True)
class FittedShallowSolver(FittedSolver, ShallowSolver):
    """Depth-averaged flow with fitted factors; all that depth-averaged flow runs it runs.

    Attributes:
        factors: that were fitted, for these cells over √(L0 H0).
    """

    factors: ShallowFactors = field(default_factory=ShallowFactors)

    def config(self, scene: Scene) -> ShallowConfig:
        """Return the settings for a scene, the factors multiplied in."""
        config, factors = super().config(scene), self.factors
        pressure = factors.earth_pressure * config.earth_pressure
        return replace(config, earth_pressure=pressure, friction_factor=factors.floor_friction * config.friction_factor)
