"""What all solvers that learned from data share: what they can run, how they fill scenes, what a run costs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.generation import chosen_every
from gns_pl.scene import Particles, Scene, fill_scene
from gns_pl.scene.filling import MAX_PARTICLES
from gns_pl.scene.refusals import check_bare
from gns_pl.solvers.reduction import Reduction, not_plane_reason, to_plane
from gns_pl.solvers.solver import Solver
from gns_pl.solvers.training_range import out_of_range
from gns_pl.trajectory import Trajectory, start_trajectory

OVERHEAD = 300
"""A learned step of few particles takes as long as one of so many."""


class TrainedSolver(Solver):
    """A solver that learned from data; one of two dimensions takes scenes in plane strain.

    Attributes:
        dim: D of what it learned.
        spacing: of its particles [m].
        interval: time of its steps [s].
        data: the specification of its data, as in conf/data/.
    """

    dim: int
    spacing: float
    interval: float
    data: Mapping[str, Any]
    provenance: Mapping[str, Any]
    dtype = "float32"

    @property
    def knows_surfaces(self) -> bool:
        """Whether it takes obstacles and terrain."""
        return False

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return what of a scene it has no means for, or None."""
        if scene.obstacles and not self.knows_surfaces:
            return "knows no obstacles"
        if scene.terrain is not None and not self.knows_surfaces:
            return "takes no terrain (solver=ground, mpm and shallow do)"
        if self.dim == 2 and scene.dim == 3:
            reasons = [not_plane_reason(scene, axis) for axis in (1, 0)]
            if None not in reasons:
                return f"runs plane strain only, and the scene is not: {reasons[0]}"
        elif self.dim != scene.dim:
            return f"has {self.dim} dimensions, the scene {scene.dim}"
        return None

    def out_of_range_reason(self, scene: Scene) -> str | None:
        """Return what of a scene was not in the data, or None."""
        reduction = self.reduced(scene)
        reason = next(out_of_range(reduction.scene, self.data), None)
        return None if reason is None else reduction.similarity.told(reason)

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice where two dimensions are wanted, else the scene itself.

        Raises:
            InputError: it cannot be run at all.
        """
        if not self.knows_surfaces:
            check_bare(f"scene {scene.name!r}", scene, self.name)
        return reduction_for(scene, self.dim)

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of particles and of steps."""
        reduced_scene = self.reduced(scene).scene
        volume = sum(body.volume for body in reduced_scene.bodies)
        return round(volume / self.spacing**reduced_scene.dim), self.num_steps(reduced_scene)

    def num_steps(self, scene: Scene) -> int:
        """Return how many steps reach the end of a scene."""
        return max(1, math.ceil(scene.duration / self.interval - 1e-6))

    def cost(self, scene: Scene) -> float:
        """Return (particles + overhead) × steps."""
        particles, steps = self.size(scene)
        return float((particles + OVERHEAD) * steps)

    def filled(self, scene: Scene, seed: int) -> Particles:
        """Return the particles that fill a scene at the spacing of the data, as irregularly as these are.

        Raises:
            InputError: a scene of another size, which would have too many.
        """
        # Of the data every k-th point of a lattice is kept, and moves in its own, k times smaller, cell. Points drawn
        # in blocks would scatter the front of a run three times as much (docs/data.md).
        number = sum(body.volume for body in scene.bodies) / self.spacing**scene.dim
        if number > MAX_PARTICLES:
            raise InputError(
                f"scene {scene.name!r} would have {number:.2g} particles at the spacing of {self.spacing:.3g} m that "
                f"{self.name} learned, the only one it has; use solver=mpm, whose cells go with the scene."
            )
        jitter = float(self.data.get("mpm", {}).get("jitter", 0.0)) / chosen_every(self.data)
        return fill_scene(scene, self.spacing, jitter=jitter, generator=np.random.default_rng(seed))

    def start(self, scene: Scene, seed: int = 0, provenance: Mapping[str, object] | None = None) -> Trajectory:
        """Return a scene filled with particles, in one frame.

        Args:
            scene: what to fill, of the solver's dimension.
            seed: of the placement.
            provenance: how the trajectory is made.
        """
        return start_trajectory(scene, self.filled(scene, seed), self.interval, dict(provenance or {}))


def reduction_for(scene: Scene, dim: int) -> Reduction:
    """Return the scene that a solver of some dimension runs: the slice of one in plane strain, or the scene itself.

    Args:
        scene: in two or three dimensions.
        dim: D of the solver.

    Raises:
        InputError: a scene in three dimensions that is not in plane strain, or one in two for a solver of three.
    """
    if dim == 2 and scene.dim == 3:
        reasons = {axis: not_plane_reason(scene, axis) for axis in (1, 0)}
        axis = next((axis for axis, reason in reasons.items() if reason is None), None)
        if axis is None:
            raise InputError(
                f"scene {scene.name!r} has 3 dimensions and the simulator 2, and it is not in plane strain: "
                f"{reasons[1]}."
            )
        return to_plane(scene, axis)
    if dim != scene.dim:
        raise InputError(f"scene {scene.name!r} has {scene.dim} dimensions, the simulator {dim}.")
    return Reduction(scene, lambda trajectory: trajectory, "")
