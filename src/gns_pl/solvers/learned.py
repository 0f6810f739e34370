"""The ways that learned from data: a simulator alone, a corrector of coarse MPM, a simulator hand in hand with MPM."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.generation import chosen_every
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint
from gns_pl.models.corrector import CorrectorFile, load_corrector
from gns_pl.models.shipped import find_corrector
from gns_pl.rollout.engine import rollout
from gns_pl.rollout.failure import Watch
from gns_pl.rollout.rest import Rest
from gns_pl.rollout.stabilise import stabilise
from gns_pl.scene import Particles, Scene, fill_scene
from gns_pl.scene.extent import characteristic_time
from gns_pl.solvers.correction import corrected_run
from gns_pl.solvers.handover import continued_by_mpm
from gns_pl.solvers.reduction import Reduction, to_plane, why_not_plane
from gns_pl.solvers.training_range import beyond
from gns_pl.trajectory import Trajectory, start_trajectory

OVERHEAD = 300
"""A learned step of few particles takes as long as one of so many."""


POINTS_PER_PARTICLE = 36
"""A step of so many material points takes as long as that of one learned particle."""


class FittedWay:
    """What is the same for all that learned from data: one of two dimensions takes scenes in plane strain.

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

    def why_not(self, scene: Scene) -> str | None:
        """Return what of a scene was not in the data, or None."""
        if scene.obstacles:
            return "knows no obstacles"
        if self.dim == 2 and scene.dim == 3:
            reasons = [why_not_plane(scene, axis) for axis in (1, 0)]
            if None not in reasons:
                return f"is of plane strain, and the scene is not: {reasons[0]}"
        elif self.dim != scene.dim:
            return f"has {self.dim} dimensions, the scene {scene.dim}"
        return next(beyond(self.reduced(scene).scene, self.data), None)

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice where two dimensions are wanted, else the scene itself.

        Raises:
            InputError: it cannot be run at all.
        """
        if scene.obstacles:
            raise InputError(f"scene {scene.name!r} has obstacles, and a learned simulator knows no obstacles yet.")
        return plane_of(scene, self.dim)

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of particles and of steps."""
        less = self.reduced(scene).scene
        volume = sum(math.prod(body.size) for body in less.bodies)
        return round(volume / self.spacing**less.dim), math.ceil(less.duration / self.interval - 1e-6)

    def work(self, scene: Scene) -> float:
        """Return (particles + overhead) × steps."""
        particles, steps = self.size(scene)
        return float((particles + OVERHEAD) * steps)


@dataclass(frozen=True)
class LearnedWay(FittedWay):
    """A learned simulator.

    Attributes:
        name: of the way.
        path: of the checkpoint, or the name of one that comes with the package.
        rest_speed: a run ends when every particle is slower [m/s]; 0 makes all its steps.
        stabilise: arguments of `stabilise`, by which its steps are kept within what sand can do.
    """

    name: str
    path: str | Path
    rest_speed: float = 0.0
    stabilise: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint, read when first needed."""
        return load_checkpoint(self.path)

    @property
    def dim(self) -> int:  # type: ignore[override]
        """D."""
        return self.checkpoint.simulator.config.dim

    @property
    def spacing(self) -> float:  # type: ignore[override]
        """Of the particles [m]."""
        return self.checkpoint.simulator.config.spacing

    @property
    def interval(self) -> float:  # type: ignore[override]
        """Time of a step [s]."""
        return self.checkpoint.simulator.config.dt

    @property
    def data(self) -> Mapping[str, Any]:  # type: ignore[override]
        """The specification of the data."""
        return self.checkpoint.data

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory; arguments as those of `Way`. One that fails (`failure`) ends there."""
        less, stepper = self.reduced(scene), stabilise(self.checkpoint.simulator, **self.stabilise)
        start = start_of(less.scene, self.checkpoint, seed, {})
        rest = Rest(self.rest_speed) if self.rest_speed else None
        made = rollout(stepper, start, self.size(scene)[1], rest=rest, watch=Watch(start, self.interval, every=10))
        return less.lift(made.resampled(interval, None if "failed_at" in made.provenance else scene.duration))


@dataclass(frozen=True)
class CorrectedWay(FittedWay):
    """Coarse MPM, corrected by a network.

    Attributes:
        name: of the way.
        path: of the corrector's file, or the name of one that comes with the package.
    """

    name: str
    path: str | Path

    @cached_property
    def file(self) -> CorrectorFile:
        """The corrector's file, read when first needed."""
        return load_corrector(find_corrector(self.path))

    @property
    def dim(self) -> int:  # type: ignore[override]
        """D."""
        return self.file.corrector.config.dim

    @property
    def spacing(self) -> float:  # type: ignore[override]
        """Of the points [m]."""
        return self.file.corrector.config.spacing

    @property
    def interval(self) -> float:  # type: ignore[override]
        """Time between corrections [s]."""
        return self.file.corrector.config.interval

    @property
    def data(self) -> Mapping[str, Any]:  # type: ignore[override]
        """The specification of the data."""
        return self.file.data

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory; arguments as those of `Way`."""
        less = self.reduced(scene)
        particles = _filled(less.scene, self.spacing, self.data, seed)
        start = start_trajectory(less.scene, particles, self.interval, {})
        made = corrected_run(self.file.corrector, start, self.size(scene)[1])
        return less.lift(made.resampled(interval, scene.duration))


@dataclass(frozen=True)
class HandedWay(LearnedWay):
    """A learned simulator, and the material point method after it; its points are the particles.

    Attributes:
        until: when the learned simulator hands over [τc = √(H0/g)].
    """

    until: float = 1.0

    def __post_init__(self) -> None:
        if not self.until > 0:
            raise InputError(f"choice.handed: {self.name} needs until above 0 τc.")

    def shares(self, scene: Scene) -> tuple[int, int]:
        """Return how many learned steps the simulator makes, and how many MPM makes in their place."""
        less, steps = self.reduced(scene).scene, self.size(scene)[1]
        early = min(steps, max(1, round(self.until * characteristic_time(less) / self.interval)))
        return early, steps - early

    @property
    def settings(self) -> dict[str, Any]:
        """Of MPM: those of the data, but for cells of two points per direction."""
        return {**self.data["mpm"], "points_per_direction": 2, "cell_size": 2 * self.spacing}

    def work(self, scene: Scene) -> float:
        """Return that of the learned steps, and of MPM's as if they were learned."""
        particles, _ = self.size(scene)
        learned, solved = self.shares(scene)
        less, cell = self.reduced(scene).scene, self.settings["cell_size"]
        fastest = max(each.p_wave_speed for each in less.materials.values())
        steps = solved * self.interval * fastest / (self.settings["courant"] * cell)
        return float((particles + OVERHEAD) * learned + particles * steps / POINTS_PER_PARTICLE)

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory; arguments as those of `Way`."""
        less = self.reduced(scene)
        stepper = stabilise(self.checkpoint.simulator, **self.stabilise)
        early, late = self.shares(scene)
        past = rollout(stepper, start_of(less.scene, self.checkpoint, seed, {}), early)
        made = past if "failed_at" in past.provenance else continued_by_mpm(past, self.settings, late)
        return less.lift(made.resampled(interval, None if "failed_at" in made.provenance else scene.duration))


def plane_of(scene: Scene, dim: int) -> Reduction:
    """Return the scene that a solver of some dimension runs: the slice of one in plane strain, or the scene itself.

    Args:
        scene: in two or three dimensions.
        dim: D of the solver.

    Raises:
        InputError: a scene in three dimensions that is not in plane strain, or one in two for a solver of three.
    """
    if dim == 2 and scene.dim == 3:
        reasons = {axis: why_not_plane(scene, axis) for axis in (1, 0)}
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


def start_of(scene: Scene, checkpoint: Checkpoint, seed: int, provenance: Mapping[str, object]) -> Trajectory:
    """Return a scene filled at the spacing of a checkpoint's data, as irregularly as these are, in one frame.

    Args:
        scene: what to fill.
        checkpoint: spacing, time step and data.
        seed: of the placement.
        provenance: how the trajectory is made.
    """
    config = checkpoint.simulator.config
    particles = _filled(scene, config.spacing, checkpoint.data, seed)
    return start_trajectory(scene, particles, config.dt, dict(provenance))


def _filled(scene: Scene, spacing: float, data: Mapping[str, Any], seed: int) -> Particles:
    # Of the data every k-th point of a lattice is kept, and moves in its own, k times smaller, cell.
    jitter = float(data.get("mpm", {}).get("jitter", 0.0)) / chosen_every(data)
    return fill_scene(scene, spacing, jitter=jitter, generator=np.random.default_rng(seed))
