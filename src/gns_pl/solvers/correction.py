"""Coarse material point runs that a network corrects on the way.

The points of the run are the particles. After every interval the corrector says by which velocity they are too slow,
and they get it. Places and stress stay those of the material point method, which finds out by itself what velocities do
to the density: put to other places as well, points drift apart and the heap swells (by a third at a = 3).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gns_pl.models.corrector import Corrector, CorrectorConfig
from gns_pl.mpm.settings import place_points, solver_config, stepped_run
from gns_pl.rollout.static import static_of
from gns_pl.scene import Particles, Scene
from gns_pl.solvers.reduction import Reduction, halve_scene
from gns_pl.solvers.retuned import MPMFactors, RetunedMPMSolver
from gns_pl.trajectory import Trajectory, start_trajectory

Floats = NDArray[np.float32]


def points_of(trajectory: Trajectory, frame: int = 0) -> Particles:
    """Return the particles of one of a trajectory's frames as points of a run.

    Args:
        trajectory: its first frame says which body a particle is of.
        frame: where the points are, and how fast.
    """
    number, names = trajectory.num_particles, list(trajectory.scene.materials)
    body = np.zeros(number, dtype=np.int64)
    for index, each in enumerate(trajectory.scene.bodies):
        start = trajectory.position[0]
        body[((start >= each.position) & (start <= each.upper)).all(axis=1)] = index
    material = np.array([names.index(each.material) for each in trajectory.scene.bodies])[body]
    return Particles(
        position=trajectory.position[frame].astype(np.float64),
        velocity=trajectory.velocity()[frame],
        mass=trajectory.mass.astype(np.float64),
        volume=trajectory.volume().astype(np.float64),
        material=trajectory.material,
        material_name=material,
        particle_type=trajectory.particle_type,
        body=body,
        lattice=np.zeros((number, trajectory.scene.dim), dtype=np.int64),
    )


@dataclass(frozen=True)
class CoarseStart:
    """Where a coarse run begins, and how it goes on.

    Attributes:
        first: its first frame; with the scene that is run.
        points: that move.
        mpm: settings of the run, as `MPMConfig`.
        unit: of the corrector's lengths [m].
        reduction: that led to the scene which is run.
    """

    first: Trajectory
    points: Particles
    mpm: Mapping[str, Any]
    unit: float
    reduction: Reduction

    @classmethod
    def of(cls, corrector: Corrector, first: Trajectory) -> CoarseStart:
        """Return the start of a run on cells of one size, from the first frame of a trajectory."""
        reduction = Reduction(first.scene, lambda trajectory: trajectory, "")
        return cls(first, points_of(first), corrector.config.mpm, 1.0, reduction)

    @classmethod
    def retuned(cls, config: CorrectorConfig, scene: Scene, seed: int, facts: Mapping[str, object]) -> CoarseStart:
        """Return the start of a run whose cells and scalars are those of `config.coarse`.

        Args:
            config: of a corrector with such a coarse run.
            scene: that is wanted; halves of it are run where it is mirrored.
            seed: of the placement.
            facts: for the provenance.

        Raises:
            InputError: settings that the solver refuses.
        """
        coarse = coarse_solver(config)
        mpm = coarse.settings_of(scene)
        reduction = coarse.retuned(halve_scene(scene), scene)
        points = place_points(reduction.scene, mpm, seed)
        first = start_trajectory(reduction.scene, points, config.interval, dict(facts))
        return cls(first, points, mpm, solver_config(mpm).spacing, reduction)


def coarse_solver(config: CorrectorConfig) -> RetunedMPMSolver:
    """Return the coarse run of a corrector as a solver of its own, without corrections."""
    assert config.coarse is not None
    factors = MPMFactors(**config.coarse["factors"])
    return RetunedMPMSolver("coarse", float(config.coarse["cells"]), config.mpm, factors=factors)


def corrected_run(corrector: Corrector, start: Trajectory | CoarseStart, num_steps: int) -> Trajectory:
    """Return a coarse run with corrections.

    Args:
        corrector: with the settings of the run.
        start: scene, placement and initial velocities; of a trajectory its first frame.
        num_steps: frames to add, the corrector's interval apart.

    Raises:
        SimulationError: the run became unstable.
    """
    began = time.perf_counter()
    start = start if isinstance(start, CoarseStart) else CoarseStart.of(corrector, start)
    frames = [position for _, position, _ in corrected_frames(corrector, start, num_steps)]
    provenance = {**start.first.provenance, "wall_seconds": time.perf_counter() - began}
    return replace(start.first, position=np.stack(frames), dt=corrector.config.interval, provenance=provenance)


State = dict[str, NDArray[Any]]


def corrected_frames(
    corrector: Corrector, start: CoarseStart, num_steps: int, saved: Mapping[str, NDArray[Any]] | None = None
) -> Iterator[tuple[int, Floats, Callable[[], State]]]:
    """Run with corrections, frame by frame.

    Args:
        corrector: as of `corrected_run`.
        start: scene, placement and initial velocities.
        num_steps: as of `corrected_run`.
        saved: what the third of an earlier frame's values returned, to go on from there to the same bits.

    Yields:
        The number of a frame, from 0 or from that of `saved`; its positions [N, D] [m]; and what returns the state
        there.

    Raises:
        SimulationError: the run became unstable.
    """
    config, static = corrector.config, static_of(start.first)
    run = stepped_run(start.first.scene, start.mpm, start.points, config.interval)
    before, first = run.position - run.velocity * config.interval, 0
    if saved is not None:
        run.restore(saved)
        before, first = saved["before"], int(saved["frame"])
    for frame in range(first, num_steps + 1):
        if frame > first:
            position = run.position
            run.advance()
            predicted = run.position
            arrays = (torch.from_numpy(array.astype(np.float32)) for array in (before, position, predicted))
            with torch.inference_mode():
                run.add_velocity(corrector(*arrays, static, start.unit).numpy())
            before = position
        here = {"before": before, "frame": np.array(frame)}
        yield frame, run.position.astype(np.float32), lambda: {**run.saved(), **here}  # noqa: B023


@torch.no_grad()
def followed_run(
    trajectory: Trajectory, corrector: Corrector, *, share: float = 1.0, position_gain: float, policy_mix: float = 0.0
) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
    """Follow a fine trajectory with a coarse run whose velocities are led to the fine ones.

    With a policy mix above 0 the run goes astray as it does with the corrector, and what is yielded leads back: so a
    network learns from its own mistakes (Ross, Gordon and Bagnell 2011).

    Args:
        trajectory: the fine one, its frames the corrector's interval apart.
        corrector: whose coarse run follows.
        share: of the missing velocity that is wanted, above 0 and up to 1.
        position_gain: share of what positions are behind that is to be caught up in an interval, besides.
        policy_mix: share of the velocity given that comes from the corrector, 0 to 1; the rest is what is wanted.

    Yields:
        For every frame positions one interval before, from which the run went on, and to which it came [N, D] [m], and
        the velocity that is wanted [N, D] [m/s].
    """
    config, static = corrector.config, static_of(trajectory)
    start, fine, dt = replace(trajectory, position=trajectory.position[:1]), trajectory.position, config.interval
    run = stepped_run(start.scene, config.mpm, points_of(start), dt)
    before, last = run.position - run.velocity * dt, trajectory.num_frames - 1
    for frame in range(1, last + 1):
        position = run.position
        run.advance()
        predicted = run.position
        after = min(frame + 1, last)
        wanted = (fine[after].astype(np.float64) - fine[frame - 1]) / ((after - frame + 1) * dt)
        velocity = share * (wanted - run.velocity) + position_gain * (fine[frame] - predicted) / dt
        arrays = tuple(each.astype(np.float32) for each in (before, position, predicted, velocity))
        yield arrays  # type: ignore[misc]
        if policy_mix:
            learned = corrector(*map(torch.from_numpy, arrays[:3]), static).numpy()
            velocity = (1 - policy_mix) * velocity + policy_mix * learned
        run.add_velocity(velocity)
        before = position
