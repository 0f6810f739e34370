"""The ways from a scene to a trajectory: learned simulators and the material point method, reduced to what is needed.

Every way says whether it can be trusted with a scene, about how much work it is, and runs it. What that is worth is
not known here but measured (`records`), and `choice` picks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gns_pl.checkpoint import Checkpoint, load_checkpoint
from gns_pl.corrector import CorrectorFile, load_corrector
from gns_pl.errors import InputError
from gns_pl.generation import chosen_every, solver
from gns_pl.pretrained import find_corrector
from gns_pl.rollout.acceleration import accelerate
from gns_pl.rollout.correction import corrected_run
from gns_pl.rollout.engine import rollout
from gns_pl.rollout.reduction import Reduction, reduce_scene, to_plane, why_not_plane
from gns_pl.rollout.rest import Rest
from gns_pl.scene import Material, Particles, Scene, Wall, fill_scene, part_from_dict
from gns_pl.trajectory import Trajectory, start_trajectory

OVERHEAD = 300
"""A learned step of few particles takes as long as one of so many."""


class Way(Protocol):
    """One way from a scene to a trajectory."""

    @property
    def name(self) -> str:
        """By which its measured runs are found."""

    def why_not(self, scene: Scene) -> str | None:
        """Return why a scene is beyond what this way was made for, or None."""

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene that is run in its place."""

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of particles and of steps of a run."""

    def work(self, scene: Scene) -> float:
        """Return what a run's time is proportional to."""

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory, with frames `interval` [s] apart."""


def characteristic_size(scene: Scene) -> float:
    """Return √(L0 H0) of all bodies together, their extent along x and z [m]."""
    extents = [
        max(body.upper[axis] for body in scene.bodies) - min(body.position[axis] for body in scene.bodies)
        for axis in (0, scene.dim - 1)
    ]
    return math.sqrt(extents[0] * extents[1])


@dataclass(frozen=True)
class MPMWay:
    """The material point method on cells that are a part of the bodies' size, in two dimensions where that holds.

    Attributes:
        name: of the way.
        cells: over √(L0 H0).
        settings: of the solver but for the cells, as in conf/data/.
        reduces: take slices and halves where they hold.
    """

    name: str
    cells: float
    settings: Mapping[str, Any]
    reduces: bool = True

    def why_not(self, scene: Scene) -> str | None:
        """Return None: it knows every scene."""
        return None

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice, half, or the scene itself."""
        return reduce_scene(scene) if self.reduces else Reduction(scene, lambda trajectory: trajectory, "")

    def settings_of(self, scene: Scene) -> dict[str, Any]:
        """Return the solver's settings for a scene."""
        return {**self.settings, "cell_size": characteristic_size(scene) / self.cells}

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the number of points and about that of steps."""
        less, settings = self.reduced(scene).scene, self.settings_of(scene)
        cell = settings["cell_size"]
        fastest = max(each.p_wave_speed for each in less.materials.values())
        drop = max(body.upper[-1] for body in less.bodies) - less.lower[-1]
        fastest += math.sqrt(2 * math.hypot(*less.gravity) * drop)
        spacing = cell / settings["points_per_direction"]
        volume = sum(math.prod(body.size) for body in less.bodies)
        return round(volume / spacing**less.dim), math.ceil(less.duration * fastest / (settings["courant"] * cell))

    def work(self, scene: Scene) -> float:
        """Return points × steps."""
        return float(math.prod(self.size(scene)))

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory; arguments as those of `Way`."""
        less, settings = self.reduced(scene), self.settings_of(scene)
        threads = solver.num_threads_alone(less.scene, settings)
        made = solver.run_solver(less.scene, settings, frame_interval=interval, seed=seed, num_threads=threads)
        return less.lift(made)


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
        if self.dim == 2 and scene.dim == 3:
            reasons = [why_not_plane(scene, axis) for axis in (1, 0)]
            if None not in reasons:
                return f"is of plane strain, and the scene is not: {reasons[0]}"
        elif self.dim != scene.dim:
            return f"has {self.dim} dimensions, the scene {scene.dim}"
        return next(_beyond(self.reduced(scene).scene, self.data), None)

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice where two dimensions are wanted, else the scene itself.

        Raises:
            InputError: it cannot be run at all.
        """
        if self.dim == 2 and scene.dim == 3:
            return to_plane(scene, next((axis for axis in (1, 0) if why_not_plane(scene, axis) is None), 1))
        if self.dim != scene.dim:
            raise InputError(f"scene {scene.name!r} has {scene.dim} dimensions, what was learned {self.dim}.")
        return Reduction(scene, lambda trajectory: trajectory, "")

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
        sleep: particles slower than this sleep [m/s] (`accelerate`).
    """

    name: str
    path: str | Path
    rest_speed: float = 0.0
    sleep: float = 0.0

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
        """Return the trajectory; arguments as those of `Way`. One that stops being finite ends there."""
        less, simulator = self.reduced(scene), accelerate(self.checkpoint.simulator, sleep=self.sleep)
        start = start_of(less.scene, self.checkpoint, seed, {})
        rest = Rest(self.rest_speed) if self.rest_speed else None
        made = rollout(simulator, start, self.size(scene)[1], rest=rest)
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


def _beyond(scene: Scene, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield what of a scene, reduced already, is beyond a data set."""
    families = [family for family in data.get("families", {}).values() if family.get("count", 1)]
    if not families:
        yield "its data do not say what they hold"
        return
    if scene.obstacles:
        yield "knows no obstacles"
    if len(scene.bodies) > 1:
        yield f"saw single bodies, the scene has {len(scene.bodies)}"
    walls = [{**data.get("walls", {}), **family.get("walls", {})} for family in families]
    known = [{face: part_from_dict(Wall, face, wall) for face, wall in each.items()} for each in walls]
    touched = [face for face in scene.walls if face != "z+"]  # nothing rises to the lid
    if all(any(each.get(face) != scene.walls[face] for face in touched) for each in known):
        yield "its walls were others"
    gravity = float(data.get("gravity", 0.0))
    if any(scene.gravity[:-1]) or abs(-scene.gravity[-1] - gravity) > 0.01 * gravity:
        yield f"its gravity was {gravity:g} m/s² downwards"
    angles = [each for family in families for each in family.get("friction_angle_deg", ())]
    base = part_from_dict(Material, "material", data["material"])
    for body in scene.bodies:
        material = scene.materials[body.material]
        angle = material.friction_angle_deg
        if angles and not min(angles) <= angle <= max(angles):
            yield f"its friction angles were {min(angles):g} to {max(angles):g}°"
        if replace(material, friction_angle_deg=base.friction_angle_deg) != base or not (
            angles or angle == base.friction_angle_deg
        ):
            yield "its material was another"
        yield from _beyond_shape(scene, body, families)


def _beyond_shape(scene: Scene, body: Any, families: list[Mapping[str, Any]]) -> Iterator[str]:
    """Yield what of a body's size, shape and motion is beyond all families."""
    length, height, speed = body.size[0], body.size[-1], math.hypot(*body.velocity)
    ratio, drop = height / length, body.position[-1] - scene.lower[-1]

    def span(*keys: str) -> tuple[float, float]:
        values = [value for family in families for key in keys for value in np.atleast_1d(family.get(key, []))]
        return (float(min(values)), float(max(values))) if values else (math.nan, math.nan)

    for what, value, (low, high), unit in (
        ("lengths", length, span("length", "side"), " m"),
        ("aspect ratios", ratio, span("aspect_ratio"), ""),
    ):
        if not 0.99 * low <= value <= 1.01 * high:
            yield f"saw {what} from {low:g} to {high:g}{unit}, not {value:.3g}"
    if speed > 1e-9 + math.sqrt(scene.dim) * span("speed")[1] or (speed and math.isnan(span("speed")[1])):
        yield f"saw initial speeds up to {span('speed')[1]:g} m/s along an axis"
    if drop > 1e-9 and not drop <= 1.01 * span("max_drop")[1]:
        yield f"saw drops up to {span('max_drop')[1]:g} m"
