"""Coarse MPM whose friction, cohesion and damping were fitted to fine MPM, as a solver of its own (docs/retuned.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from gns_pl.scene import Scene, Wall
from gns_pl.scene.boundaries import Obstacle
from gns_pl.scene.definition import Material
from gns_pl.solvers.fitted import Factors, FittedSolver
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.reduction import Reduction
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class MPMFactors(Factors):
    """By what coarse MPM changes a scene and its own damping.

    Attributes:
        wall_friction: on the coefficients of Coulomb friction of all walls and obstacles.
        internal_friction: on tan φ of all materials; the dilation angle stays, but never above φ.
        cohesion: on the cohesion of all materials.
        damping_rate: on the solver's damping rate.
    """

    wall_friction: float = 1.0
    internal_friction: float = 1.0
    cohesion: float = 1.0
    damping_rate: float = 1.0

    def material(self, material: Material) -> Material:
        """Return a material as coarse MPM takes it."""
        angle = math.degrees(math.atan(self.internal_friction * material.tan_friction_angle))
        return replace(
            material,
            friction_angle_deg=angle,
            dilation_angle_deg=min(material.dilation_angle_deg, angle),
            cohesion=self.cohesion * material.cohesion,
        )

    def wall(self, wall: Wall) -> Wall:
        """Return a wall likewise."""
        return replace(wall, friction=self.wall_friction * wall.friction)

    def obstacle(self, obstacle: Obstacle) -> Obstacle:
        """Return an obstacle likewise."""
        return replace(obstacle, wall=self.wall(obstacle.wall))

    def scene(self, scene: Scene) -> Scene:
        """Return a scene likewise."""
        return scene.replace(
            materials={name: self.material(each) for name, each in scene.materials.items()},
            walls={face: self.wall(each) for face, each in scene.walls.items()},
            obstacles=tuple(map(self.obstacle, scene.obstacles)),
            terrain=scene.terrain and scene.terrain.replace(wall=self.wall(scene.terrain.wall)),
        )

    def settings(self, mpm: Mapping[str, Any]) -> dict[str, Any]:
        """Return the method's settings likewise."""
        return {**mpm, "damping_rate": self.damping_rate * mpm["damping_rate"]}


@dataclass(frozen=True)
class RetunedMPMSolver(FittedSolver, MPMSolver):
    """The material point method with fitted factors; all that MPM runs it runs, slices and halves among it.

    Attributes:
        factors: that were fitted, for these cells over √(L0 H0).
    """

    factors: MPMFactors = field(default_factory=MPMFactors)
    group: str = field(default="retuned", init=False)

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice or half with the material and walls that are run; what is lifted has its own."""
        return self.retuned(super().reduced(scene), scene)

    def retuned(self, reduction: Reduction, scene: Scene) -> Reduction:
        """Return a reduction of a scene with the material and walls that are run."""

        def lift(trajectory: Trajectory) -> Trajectory:
            return replace(reduction.lift(replace(trajectory, scene=reduction.scene)), scene=scene)

        return replace(reduction, scene=self.factors.scene(reduction.scene), lift=lift)

    def settings_of(self, scene: Scene) -> dict[str, Any]:
        """Return the method's settings for a scene."""
        return self.factors.settings(super().settings_of(scene))
