"""Runs of the suite, by a learned simulator or by the material point method, and what is kept of each."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.evaluation.stress.momentum import momentum_residual
from gns_pl.evaluation.stress.suite import StressScene
from gns_pl.generation import chosen_every, reference_trajectory, thin_trajectory
from gns_pl.metrics.measures import centre_of_mass, particle_spacing
from gns_pl.models.checkpoint import Checkpoint
from gns_pl.mpm import settings as solver
from gns_pl.mpm.config import SimulationError
from gns_pl.rollout.engine import rollout
from gns_pl.rollout.failure import Failure, Watch
from gns_pl.rollout.stepper import Stepper
from gns_pl.scene import Particles, fill_scene
from gns_pl.scene.extent import characteristic_time
from gns_pl.solvers.ood import compute_ood
from gns_pl.solvers.training_range import out_of_range
from gns_pl.trajectory import Trajectory, start_trajectory


@dataclass(frozen=True)
class Row:
    """What became of a scene.

    Attributes:
        model: name of what ran it.
        identity: of the model, its settings and the scene, by which a broken suite goes on.
        settings: as `Subject`.
        scene: its name.
        axis: along which it is stressed.
        value: how far.
        inside: whether nothing of the scene is beyond the model's data; for the material point method, true.
        particles: their number.
        steps: that were to be made.
        duration: to be simulated [τc].
        kind: of the first failure; empty if there is none.
        failed_at: its time [τc]; NaN if there is none.
        message: what was seen.
        exit_time: at which the run left the training range [τc]; NaN if it did not, or nobody can say.
        energy_rise: largest rise of the energy over the least before, over that at the start.
        crowded: largest share of particles nearer than 0.3 of the first distance of neighbours.
        momentum: 95 % of the frames leave less of the acceleration unexplained [g].
        drift: displacement of the centre of mass [spacings], of heaps.
        drift_largest: largest displacement of a particle [spacings], of heaps.
        seconds: of the run, with what watches it.
    """

    model: str
    identity: str
    settings: str
    scene: str
    axis: str
    value: str
    inside: bool
    particles: int
    steps: int
    duration: float
    kind: str
    failed_at: float
    message: str
    exit_time: float
    energy_rise: float
    crowded: float
    momentum: float
    drift: float
    drift_largest: float
    seconds: float

    @property
    def announced(self) -> bool:
        """Whether there was a warning before: the scene is beyond the data, or the run had left the training range."""
        return bool(self.kind) and (not self.inside or self.exit_time <= self.failed_at)


@dataclass(frozen=True)
class Subject:
    """What is stressed.

    Attributes:
        name: for tables and figures.
        identity: of its weights and settings.
        settings: by which its runs are stabilised, or what differs from the usual ones, in words.
        data: the specification of its data, or at least of the sand and of the material point method.
        interval: between frames [s].
        checkpoint: a learned simulator; None for the material point method.
        stepper: makes the steps, in the place of the checkpoint's simulator.
    """

    name: str
    identity: str
    settings: str
    data: Mapping[str, Any]
    interval: float
    checkpoint: Checkpoint | None = None
    stepper: Stepper | None = None


def run_scene(subject: Subject, stress: StressScene, *, seed: int, cache: Path) -> Row:
    """Run a scene until it ends or fails.

    Args:
        subject: what is stressed.
        stress: the scene.
        seed: of the particles' placement, and of what is added to it.
        cache: folder of references, which heaps start from.
    """
    solve = _learned if subject.checkpoint is not None else _solved
    trajectory, watch, seconds, inside, exit_time = solve(subject, stress, seed, cache)
    failure, scene = watch.failure, stress.scene
    tau, heap = characteristic_time(scene), stress.axis == "heap"
    spacing = particle_spacing(trajectory)
    steps = round(scene.duration / subject.interval)
    momentum = momentum_residual(trajectory, 1.5 * spacing) if trajectory.num_frames > 2 else np.zeros(1)
    drift = drift_largest = math.nan
    if heap and trajectory.num_frames > 1:
        centre = centre_of_mass(trajectory)
        moved = np.linalg.norm(trajectory.position[-1].astype(np.float64) - trajectory.position[0], axis=1)
        drift, drift_largest = float(np.linalg.norm(centre[-1] - centre[0])) / spacing, float(moved.max()) / spacing
    return Row(
        model=subject.name,
        identity=subject.identity,
        settings=subject.settings,
        scene=scene.name,
        axis=stress.axis,
        value=stress.value,
        inside=inside,
        particles=trajectory.num_particles,
        steps=steps,
        duration=scene.duration / tau,
        kind=failure.kind if failure else "",
        failed_at=failure.time / tau if failure else math.nan,
        message=failure.message if failure else "",
        exit_time=math.nan if exit_time is None else exit_time / tau,
        energy_rise=watch.rise,
        crowded=watch.crowded,
        momentum=float(np.quantile(momentum, 0.95)),
        drift=drift,
        drift_largest=drift_largest,
        seconds=seconds,
    )


Outcome = tuple[Trajectory, Watch, float, bool, float | None]


def _learned(subject: Subject, stress: StressScene, seed: int, cache: Path) -> Outcome:
    checkpoint, scene = subject.checkpoint, stress.scene
    assert checkpoint is not None
    config, data = checkpoint.simulator.config, subject.data
    every = chosen_every(data)
    if stress.settled:
        settling = scene.replace(duration=stress.settled)
        interval = settling.duration / 20
        whole = reference_trajectory(
            settling, data["mpm"], frame_interval=interval, seed=seed, cache_directory=cache, progress=False
        )
        fine = thin_trajectory(whole, data["mpm"], seed, every, [(every - 1) // 2] * scene.dim)
        start = replace(
            fine,
            position=fine.position[-1:],
            dt=config.dt,
            scene=scene,
            initial_velocity=np.zeros_like(fine.initial_velocity),
        )
    else:
        jitter = float(data.get("mpm", {}).get("jitter", 0.0)) / every if stress.jitter is None else stress.jitter
        particles = _filled(stress, config.spacing * stress.coarseness, jitter, seed)
        start = start_trajectory(scene, particles, config.dt, {})
    watch = Watch(start, config.dt)
    began = time.perf_counter()
    trajectory = rollout(subject.stepper or checkpoint.simulator, start, round(scene.duration / config.dt), watch=watch)
    seconds = time.perf_counter() - began
    ood = compute_ood(checkpoint, trajectory, every=max(1, trajectory.num_frames // 100))
    usual = stress.coarseness == 1 and stress.jitter is None and not stress.shake and not stress.displaced
    inside = usual and next(out_of_range(scene, data), None) is None
    return trajectory, watch, seconds, inside, None if ood is None else ood.exit_time


def _solved(subject: Subject, stress: StressScene, seed: int, cache: Path) -> Outcome:
    mpm, scene, interval = dict(subject.data["mpm"]), stress.scene, subject.interval
    if stress.by_points:
        mpm["points_per_direction"] = max(1, round(mpm["points_per_direction"] / stress.coarseness))
    else:
        mpm["cell_size"] *= stress.coarseness
    spacing = mpm["cell_size"] / mpm["points_per_direction"]
    particles = _filled(stress, spacing, mpm["jitter"] if stress.jitter is None else stress.jitter, seed)
    whole = scene.replace(duration=scene.duration + stress.settled)
    began = time.perf_counter()
    run = solver.stepped_run(whole, mpm, particles, interval)
    start = start_trajectory(scene, particles, interval, {})
    settling, failure, frames = round(stress.settled / interval), None, []
    try:
        for _ in range(settling):
            run.advance()
        start = replace(start, position=run.position[None].astype(np.float32))
        if settling:
            start = replace(start, initial_velocity=run.velocity.astype(np.float32))
        watch = Watch(start, interval)
        for _ in range(round(scene.duration / interval)):
            run.advance()
            frames.append(run.position.astype(np.float32))
            if watch.look(frames[-1]) is not None:
                break
    except SimulationError as error:
        watch = watch if frames else Watch(start, interval)
        failure = Failure("stopped", (len(frames) + 1) * interval, str(error))
        watch.failure = watch.failure or failure
    trajectory = replace(start, position=np.stack([start.position[0], *frames]))
    return trajectory, watch, time.perf_counter() - began, True, None


def _filled(stress: StressScene, spacing: float, jitter: float, seed: int) -> Particles:
    scene, generator = stress.scene, np.random.default_rng(seed)
    particles = fill_scene(scene, spacing, jitter=jitter, generator=generator)
    position = particles.position + stress.displaced * spacing * generator.standard_normal(particles.position.shape)
    margin = 0.25 * spacing  # a point may not begin in a wall
    inside = np.clip(position, np.array(scene.lower) + margin, np.array(scene.upper) - margin)
    velocity = particles.velocity + stress.shake * generator.standard_normal(particles.velocity.shape)
    return replace(particles, position=inside if stress.displaced else particles.position, velocity=velocity)
