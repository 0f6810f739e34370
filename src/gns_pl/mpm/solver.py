"""`simulate` and `simulate_batch`: fill scenes, run them, and keep the frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.mpm.config import MPMConfig, SimulationError
from gns_pl.mpm.plan import NUM_POINT_ARRAYS, ORDER, SAVED, Plan, make_grid, make_plan, make_setting, make_state
from gns_pl.scene import Particles, Scene, fill_scene
from gns_pl.trajectory import Trajectory, start_trajectory

DEVICES = ("cpu", "cuda")


def simulate(
    scene: Scene,
    config: MPMConfig,
    *,
    frame_interval: float,
    seed: int = 0,
    on_frame: Callable[[int, int], None] | None = None,
    num_threads: int = 1,
    device: str = "cpu",
) -> Trajectory:
    """Run `scene` from its start over its duration.

    The kernels release the GIL. On a CPU the same arguments give the same bits on the same machine, whatever
    `num_threads`; on a GPU the same numbers within rounding.

    Args:
        scene: what to simulate, in two or three dimensions.
        config: how.
        frame_interval: time between the frames kept [s].
        seed: of the generator that draws the jitter of the points.
        on_frame: called after every frame with its index (from 0) and the number of frames.
        num_threads: threads that share a step; worth it from some 10,000 points on. For the CPU.
        device: "cpu", or "cuda" for the GPU, where `simulate_batch` makes more of small scenes.

    Returns:
        round(duration / frame_interval) + 1 frames.

    Raises:
        InputError: a frame interval that is not positive, cells that do not fit the box, too many threads, an unknown
            device, or "cuda" where numba finds none.
        SimulationError: velocities that are not finite or far above what the scene's energy allows, or a point that
            left the box; the message says when and where.
    """
    if device not in DEVICES:
        raise InputError(f"mpm: device must be one of {', '.join(DEVICES)}, not {device!r}.")
    if device == "cuda":
        return simulate_batch([scene], config, frame_interval=frame_interval, seeds=[seed], on_frame=on_frame)[0]
    particles, plan = start_run(scene, config, float(frame_interval), seed)
    frames = np.empty((plan.num_frames, len(particles.position), scene.dim), dtype=np.float32)
    for progress in advance_frames(plan, particles, num_threads=num_threads):
        frames[progress.frame] = progress.position()
        if on_frame is not None:
            on_frame(progress.frame, plan.num_frames)
    provenance = plan.provenance(seed) | {"device": "cpu", "num_threads": num_threads}
    return replace(start_trajectory(scene, particles, frame_interval, provenance), position=frames)


@dataclass
class Progress:
    """A run at one of its frames.

    Attributes:
        plan: of the run.
        frame: its number, from 0.
        state: of the points, in an order that changes from frame to frame, and the grid.
        original: of every point, its number at the start [N].
    """

    plan: Plan
    frame: int
    state: tuple[NDArray[Any], ...]
    original: NDArray[np.int64]

    def position(self) -> NDArray[np.float32]:
        """Return the points' positions in the order of the start [N, D] [m]."""
        position = np.empty((len(self.original), self.plan.scene.dim), dtype=np.float32)
        position[self.original] = self.plan.place(self.state[0])
        return position

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return what `advance_frames` needs to go on from here, to the same bits."""
        return {name: self.state[index].copy() for name, index in SAVED.items()} | {
            "frame": np.array(self.frame),
            "original": self.original,
        }


def advance_frames(
    plan: Plan, particles: Particles, *, num_threads: int = 1, saved: Mapping[str, NDArray[Any]] | None = None
) -> Iterator[Progress]:
    """Run a plan on the CPU, frame by frame.

    Args:
        plan: of the run.
        particles: its points at the start.
        num_threads: as of `simulate`.
        saved: what `Progress.saved` gave at an earlier frame of the same run, to go on from there.

    Yields:
        The run at frame 0, or at the saved one, and at every later frame; what is yielded is the same object's arrays
        until the next frame.

    Raises:
        InputError: too many threads.
        SimulationError: as `simulate`.
    """
    state = make_state(plan.scene, particles, plan.grid, plan.config)
    setting = make_setting(plan.scene, plan.grid, plan.config, plan.dt)
    original, first = np.arange(len(particles.position)), 0
    if saved is not None:
        original, first = saved["original"], int(saved["frame"])
        state = _reordered(state, original)
        for name, index in SAVED.items():
            state[index][:] = saved[name]
    with _advance(plan, num_threads) as advance:
        for frame in range(first, plan.num_frames):
            if frame > first:
                # Points mix as they flow; kept in the order of the last step's blocks, a step of a large scene takes
                # half as long.
                order = state[ORDER].copy()
                state, original = _reordered(state, order), original[order]
                before = [array.copy() for array in state[:4]]
                left = advance(*state, *setting, num_threads, plan.steps)
                if left or not _fastest(state[1]) <= plan.speed_limit:  # NaN comes here too
                    state = _reordered((*before, *state[4:]), np.argsort(original))
                    raise _failure(plan, (frame - 1) * plan.steps, state, partial(advance, *state, *setting, 1, 1))
            yield Progress(plan, frame, state, original)


def simulate_batch(
    scenes: Sequence[Scene],
    config: MPMConfig,
    *,
    frame_interval: float,
    seeds: Sequence[int],
    on_frame: Callable[[int, int], None] | None = None,
) -> list[Trajectory]:
    """Run many scenes at once on the GPU, which a single small one leaves mostly idle.

    Each has its own time step and duration; what comes out does not depend on what else is in the batch, within
    rounding.

    Args:
        scenes: what to simulate, all in two or all in three dimensions.
        config: how.
        frame_interval: time between the frames kept [s].
        seeds: one for each scene, of the generator that draws the jitter of its points.
        on_frame: called after every frame with its index (from 0) and the number of frames of the longest scene.

    Returns:
        A trajectory for each scene, with the frames that `simulate` gives.

    Raises:
        InputError: as `simulate`; other numbers of seeds than of scenes, or scenes of different dimensions.
        SimulationError: as `simulate`, for the first scene that failed in the earliest frame in which one did.
    """
    if len(seeds) != len(scenes):
        raise InputError(f"mpm: {len(scenes)} scenes need as many seeds, not {len(seeds)}.")
    if len({scene.dim for scene in scenes}) > 1:
        raise InputError("mpm: the scenes of a batch must all be of one dimension; make a batch for each.")
    if not scenes:
        return []
    starts = [start_run(scene, config, frame_interval, seed) for scene, seed in zip(scenes, seeds, strict=True)]
    if not has_cuda():
        raise InputError(
            "mpm: numba finds no CUDA device; choose device=cpu, or, where there is an NVIDIA GPU, install the solver "
            "for it: pip install 'gns_pl[cuda]'."
        )
    from gns_pl.mpm.batch import Batch, gpu_name

    plans = [plan for _, plan in starts]
    states = [make_state(plan.scene, particles, plan.grid, config)[:8] for particles, plan in starts]
    batch = Batch(plans, states)
    frames = [np.empty((plan.num_frames, len(start.mass), plan.scene.dim), np.float32) for start, plan in starts]
    num_frames = max(plan.num_frames for plan in plans)
    for frame in range(num_frames):
        if frame > 0:
            flags = batch.advance([plan.steps if frame < plan.num_frames else 0 for plan in plans])
            if flags.any():
                failed = int(flags.any(axis=1).argmax())
                replayed = batch.replay(failed, states[failed])
                raise _failure(plans[failed], (frame - 1) * plans[failed].steps, *replayed)
        places = batch.places()
        for index, plan in enumerate(plans):
            if frame < plan.num_frames:
                own = places[batch.first[index] : batch.first[index + 1]]
                frames[index][frame] = own[:, list(plan.grid.axes)]
        if on_frame is not None:
            on_frame(frame, num_frames)
    where = {"device": "cuda", "gpu": gpu_name()}
    return [
        replace(start_trajectory(plan.scene, start, frame_interval, plan.provenance(seed) | where), position=kept)
        for (start, plan), seed, kept in zip(starts, seeds, frames, strict=True)
    ]


def start_run(scene: Scene, config: MPMConfig, frame_interval: float, seed: int) -> tuple[Particles, Plan]:
    """Return the points that fill a scene, and the plan of their run; arguments and errors as those of `simulate`."""
    if not (math.isfinite(frame_interval) and frame_interval > 0):
        raise InputError(f"mpm: frame_interval must be a positive number, not {frame_interval}.")
    particles = start_points(scene, config, seed)
    return particles, make_plan(scene, particles, config, frame_interval)


def start_points(scene: Scene, config: MPMConfig, seed: int) -> Particles:
    """Return the points that fill a scene, on the ground as the grid has it; arguments and errors as of `simulate`."""
    from gns_pl.mpm.ground import on_ground

    particles = fill_scene(scene, config.spacing, jitter=config.jitter, generator=np.random.default_rng(seed))
    return on_ground(scene, particles, make_grid(scene, config.cell_size))


def has_cuda() -> bool:
    """Tell whether numba finds a CUDA device."""
    try:
        from numba import cuda
    except ImportError:  # numba may leave the target to numba-cuda one day
        return False
    return bool(cuda.is_available())


@contextmanager
def _advance(plan: Plan, num_threads: int) -> Iterator[Callable[..., int]]:
    """Give the kernel of a plan, and `num_threads` to numba as long as it is used."""
    import numba

    from gns_pl.mpm.grid import make_advance

    most = numba.config.NUMBA_NUM_THREADS
    if not 1 <= num_threads <= most:
        raise InputError(f"mpm: num_threads must lie between 1 and {most}, not {num_threads}.")
    config, terrain = plan.config, plan.scene.terrain is not None
    advance = make_advance(config.shape, config.precision, num_threads > 1, config.law, terrain)
    if num_threads == 1:
        yield advance
        return
    before = numba.get_num_threads()
    numba.set_num_threads(num_threads)
    try:
        yield advance
    finally:
        numba.set_num_threads(before)


def _reordered(state: tuple[NDArray[Any], ...], order: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return a state with its points in another order."""
    return (*(array[order] for array in state[:NUM_POINT_ARRAYS]), *state[NUM_POINT_ARRAYS:])


def _fastest(velocity: NDArray[Any]) -> float:
    return math.sqrt(np.square(velocity, dtype=np.float64).sum(axis=1).max())


def _failure(plan: Plan, steps: int, state: tuple[NDArray[Any], ...], make_step: Callable[[], int]) -> SimulationError:
    """Go step by step through the frame that failed, and tell when and where it did.

    Args:
        plan: of the run.
        steps: made before.
        state: before that frame, which `make_step` changes in place.
        make_step: makes one step and returns the number of coordinates put back.
    """
    position, velocity = state[:2]
    left, made = 0, 0
    while made < plan.steps:
        before = position.copy()
        left = make_step()
        made += 1
        if left or not _fastest(velocity) <= plan.speed_limit:
            break
    speed = np.sqrt(np.square(velocity, dtype=np.float64).sum(axis=1))
    broken = ~np.isfinite(speed)
    if broken.any():
        point, what = int(broken.argmax()), "a velocity is not finite"
    elif left:
        point, what = int(np.abs(position - before).max(axis=1).argmax()), "a point left the domain"
    else:
        point = int(speed.argmax())
        what = f"a point moves at {speed[point]:.3g} m/s where about {plan.speed:.3g} m/s can be reached"
    where = ", ".join(f"{value:.3g}" for value in plan.place(before)[point])
    return SimulationError(
        f"scene {plan.scene.name!r}: the simulation is unstable: {what} in step {steps + made} at "
        f"{(steps + made) * plan.dt:.6g} s, point {point} at ({where}) m (courant {plan.config.courant:g}, time step "
        f"{plan.dt:.3g} s); choose a smaller courant."
    )
