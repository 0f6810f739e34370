"""A learned simulator until some time, and the material point method after it, as a solver.

Frames pass from one to the other, and nothing else. The material point method needs a stress besides, which frames do
not show: it gets the one by which each particle bears what lies above it, as fast as that is seen to fall
(`overburden_stress`). So a heap neither drops until its weight is borne nor is blown up, and what falls freely is not
pressed.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import gns_pl
from gns_pl.errors import InputError
from gns_pl.graph.context import context_fields
from gns_pl.mpm.settings import solver_version, stepped_run
from gns_pl.rollout.static import static_of
from gns_pl.scene import Scene
from gns_pl.scene.extent import characteristic_time, num_frames
from gns_pl.solvers.correction import points_of
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.reduction import Reduction
from gns_pl.solvers.solver import Solver, hashed
from gns_pl.solvers.trained import OVERHEAD
from gns_pl.trajectory import Trajectory

POINTS_PER_PARTICLE = 36
"""A step of so many material points takes as long as that of one learned particle."""


@dataclass(frozen=True)
class HybridSolver(Solver):
    """A learned simulator, and the material point method after it; its points are the particles.

    Attributes:
        name: of the solver.
        learned: makes the first steps.
        until: when it hands over [τc = √(H0/g)].
    """

    name: str
    learned: LearnedSolver
    until: float = 1.0
    group: str = field(default="hybrid", init=False)

    def __post_init__(self) -> None:
        if not self.until > 0:
            raise InputError(f"choice.hybrid: {self.name} needs until above 0 τc.")

    def file(self) -> Path | None:
        """Return the checkpoint's file."""
        return self.learned.file()

    def identity(self) -> str:
        """Return a hash of the learned part, the time and the material point method's sources."""
        return hashed([self.learned.identity(), self.until, solver_version()])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return name, version, the checkpoint and the time."""
        return {**self.learned.facts(scene), "solver": self.name, "version": gns_pl.__version__, "until": self.until}

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return what of a scene the learned part has no means for."""
        return self.learned.unsupported_reason(scene)

    def out_of_range_reason(self, scene: Scene) -> str | None:
        """Return what of a scene was not in the learned part's data."""
        return self.learned.out_of_range_reason(scene)

    def reduced(self, scene: Scene) -> Reduction:
        """Return what the learned part runs."""
        return self.learned.reduced(scene)

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of particles and of steps, as if all were learned."""
        return self.learned.size(scene)

    def shares(self, scene: Scene) -> tuple[int, int]:
        """Return how many learned steps are made, and how many the material point method makes in their place."""
        reduced_scene, steps = self.reduced(scene).scene, self.size(scene)[1]
        early = min(steps, max(1, round(self.until * characteristic_time(reduced_scene) / self.learned.interval)))
        return early, steps - early

    @property
    def settings(self) -> dict[str, Any]:
        """Of the material point method: those of the data, but for cells of two points per direction."""
        return {**self.learned.data["mpm"], "points_per_direction": 2, "cell_size": 2 * self.learned.spacing}

    def cost(self, scene: Scene) -> float:
        """Return that of the learned steps, and of the others as if they were learned."""
        particles, _ = self.size(scene)
        early, late = self.shares(scene)
        reduced_scene, cell = self.reduced(scene).scene, self.settings["cell_size"]
        fastest = max(material.p_wave_speed for material in reduced_scene.materials.values())
        steps = late * self.learned.interval * fastest / (self.settings["courant"] * cell)
        return float((particles + OVERHEAD) * early + particles * steps / POINTS_PER_PARTICLE)

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return the trajectory; arguments and errors as those of `Solver.run`."""
        if interval is not None:
            num_frames(scene, interval)  # refuses one that leaves nothing to show
        reduction = self.reduced(scene)
        early, late = self.shares(scene)
        start = self.learned.start(reduction.scene, seed)
        trajectory = self.learned.run(start, monitor=monitor, num_steps=early)
        if "failed_at" not in trajectory.provenance:
            trajectory = continued_by_mpm(trajectory, self.settings, late)
        failed = "failed_at" in trajectory.provenance
        trajectory = replace(trajectory, provenance={**trajectory.provenance, **self.facts(scene)})
        if interval is not None:
            end = None if failed else reduction.scene.duration
            trajectory = trajectory.resampled(interval / reduction.similarity.time, end)
        return reduction.lift(trajectory)


def continued_by_mpm(past: Trajectory, mpm: Mapping[str, Any], num_steps: int) -> Trajectory:
    """Return a trajectory that the material point method goes on with; its points are the particles.

    Args:
        past: frames; the last one's velocities are backward differences.
        mpm: settings of the solver, as in conf/data/, with cells as the particles' spacing asks for.
        num_steps: frames to add, as far apart as those of `past`.

    Raises:
        InputError: settings the solver refuses.
        SimulationError: the run became unstable.
    """
    from gns_pl.mpm.stepping import geostatic_stress

    began, points = time.perf_counter(), points_of(past, -1)
    acceleration = past.acceleration()[-1] if past.num_frames > 1 else np.zeros_like(points.velocity)
    # A backward difference is the velocity of half a frame before.
    points = replace(points, velocity=points.velocity + 0.5 * past.dt * acceleration)
    run = stepped_run(past.scene, mpm, points, past.dt)
    load = overburden_stress(past, acceleration, float(mpm["cell_size"]))
    run.stress = geostatic_stress(past.scene, points, load)
    frames = [past.position]
    for _ in range(num_steps):
        run.advance()
        frames.append(run.position.astype(np.float32)[None])
    provenance = {
        "solver": "gns_pl.solvers.hybrid",
        "handed_over_at": (past.num_frames - 1) * past.dt,
        "wall_seconds": float(past.provenance.get("wall_seconds", 0.0)) + time.perf_counter() - began,  # type: ignore[arg-type]
    }
    return replace(past, position=np.concatenate(frames), provenance=provenance)


def overburden_stress(trajectory: Trajectory, acceleration: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Return what every particle carries of the material above it in the last frame [N] [Pa].

    The vertical momentum of a column of it: ∫ ρ (g + a_z) dz from the particle upwards.

    Args:
        trajectory: its last frame.
        acceleration: of the particles [N, D] [m/s²].
        cell: of the grid by whose cells it is found [m].
    """
    static = static_of(trajectory)
    density = torch.from_numpy(trajectory.mass) / static.volume
    thickness, momentum, *_ = context_fields(
        torch.from_numpy(trajectory.position[-1]),
        torch.from_numpy(acceleration.astype(np.float32)),
        static.grid(cell),
        static.batch,
        volume=static.volume,
    )
    load: NDArray[np.float64] = (density * (momentum[:, -1] - trajectory.scene.gravity[-1] * thickness)).numpy()
    return load
