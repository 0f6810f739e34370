"""The loop: step, hand the frames on, repeat. Any number of scenes at once, from their first frame or from later ones.

`unroll` is the loop, and keeps nothing but the history a step needs; `rollout` collects its frames, `rollout.stream`
writes them to files, `rollout.gradient` differentiates through the same steps. What accelerates a step stands in
`rollout.acceleration`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gns_pl.data.places import check_frames
from gns_pl.errors import InputError
from gns_pl.machine import machine_name
from gns_pl.models.config import SimulatorConfig
from gns_pl.rollout.failure import Failure, Watch
from gns_pl.rollout.rest import Rest
from gns_pl.rollout.static import static_of
from gns_pl.rollout.statics import is_resting_heap
from gns_pl.rollout.stepper import Stepper
from gns_pl.scene.refusals import check_bare
from gns_pl.trajectory import Trajectory, ballistic_history


@dataclass(frozen=True)
class Run:
    """One scene on its way.

    Attributes:
        start: its first frame, initial velocity, types, material and scene; later frames only for kinematic particles,
            whose script they are.
        num_steps: frames to add.
        past: frames made before, the latest last [K, N, D] [m]; the first frame of `start` alone if None.
        made: number of the latest of them.
    """

    start: Trajectory
    num_steps: int
    past: NDArray[np.float32] | None = None
    made: int = 0


def history_of(run: Run, config: SimulatorConfig, frames: int = 0) -> Tensor:
    """Return the positions a step needs [N, H, D] [m].

    Before the first frame they are ballistic (x0 − k v0 Δt), so that a scene alone is enough to start from.

    Args:
        run: the scene.
        config: of the simulator.
        frames: that are wanted, if more than H: of those before, the ones that were never made are NaN, except those of
            a heap that rests (`statics`), which has been where it is.
    """
    length, start = config.input_sequence_length, run.start
    recent = start.position[:1] if run.past is None else run.past[-max(length, frames) :]
    before = ballistic_history(start.position[0], start.initial_velocity, config.dt, length)[:-1]
    # A run that goes on early still looks back before its first frame, as the single run does.
    positions = np.concatenate([before, recent])[-max(length, frames) :]
    if len(positions) < frames:
        still = is_resting_heap(start)
        missing = np.full_like(positions[:1], np.nan) if not still else positions[:1]
        positions = np.concatenate([missing.repeat(frames - len(positions), axis=0), positions])
    positions = positions.astype(np.float32)
    return torch.from_numpy(positions).transpose(0, 1).contiguous()


def check_run(run: Run, config: SimulatorConfig) -> None:
    """Raise an `InputError` if a start does not fit the simulator."""
    start = run.start
    if start.scene.dim != config.dim:
        raise InputError(f"this simulator has {config.dim} dimensions, scene {start.scene.name!r} {start.scene.dim}.")
    if not config.sees_surfaces:
        check_bare(f"scene {start.scene.name!r}", start.scene)
    if start.material_features[: len(config.material_features)] != config.material_features:
        raise InputError(
            f"this simulator needs the material features {list(config.material_features)}, "
            f"not {list(start.material_features)}."
        )
    check_frames(f"scene {start.scene.name!r}", start.position[:1], start.particle_type, start.scene, start.spacing)
    unknown = sorted(set(np.unique(start.particle_type).tolist()) - set(config.particle_types))
    if unknown:
        raise InputError(f"particle types {unknown} were not in the simulator's data.")
    scripted = not bool(static_of(start).moved.all())
    if scripted and (start.num_frames <= run.made + run.num_steps or not np.isclose(start.dt, config.dt)):
        raise InputError("kinematic particles need a script: positions in every frame at the simulator's time step.")


def unroll(
    stepper: Stepper,
    runs: Sequence[Run],
    *,
    rest: Rest | None = None,
    watches: Sequence[Watch | None] | None = None,
) -> Iterator[dict[int, Tensor]]:
    """Step scenes together, on the stepper's device, until each has made its steps.

    A scene whose positions stop being finite is stepped no more, and neither is one that is done; the others go on.

    Args:
        stepper: makes one step: a simulator, or what wraps one.
        runs: the scenes.
        rest: by which scenes end that have come to rest; None makes all their steps.
        watches: of the scenes, which end at what theirs calls a failure, after that frame; None watches nothing.

    Yields:
        After every step, number of the scene → its positions [N, D] [m], of those that made it and are finite.

    Raises:
        InputError: a start that does not fit the simulator.
    """
    for run in runs:
        check_run(run, stepper.config)
    device, length = stepper.device, stepper.history_length
    active = [number for number, run in enumerate(runs) if run.num_steps > 0]
    histories = {number: history_of(runs[number], stepper.config, length).to(device) for number in active}
    count = 0
    while active:
        scenes = static_of(*(runs[number].start for number in active), config=stepper.config).to(device)
        history = torch.cat([histories[number] for number in active])
        lengths = [runs[number].start.num_particles for number in active]
        scripted = torch.nonzero(~scenes.moved)[:, 0]
        going = active
        while going == active:
            count += 1
            position = stepper(history, scenes)
            if len(scripted):
                frames = [runs[number].start.position[runs[number].made + count] for number in active]
                position = position.index_put((scripted,), _tensor(frames, device)[scripted])
            before = history[:, -1]
            history = torch.cat([history[:, 1:], position[:, None]], dim=1)
            parts = dict(zip(active, torch.split(position, lengths), strict=True))
            finite = parts
            if not bool(torch.isfinite(position.detach()).all()):
                finite = {number: part for number, part in parts.items() if bool(torch.isfinite(part).all())}
            going = [number for number in finite if runs[number].num_steps > count]
            if watches is not None:
                failed = {number for number in parts if _has_failed(watches[number], parts[number])}
                going = [number for number in going if number not in failed]
            yield finite
            if rest is not None:
                last = dict(zip(active, torch.split(before, lengths), strict=True))
                dt = stepper.config.dt
                going = [number for number in going if not rest.reached(number, last[number], finite[number], dt)]
        histories = dict(zip(active, torch.split(history, lengths), strict=True))
        active = going


def _has_failed(watch: Watch | None, position: Tensor) -> bool:
    """Show a frame [N, D] [m] to a watch, where it needs it: what is on a GPU is not copied for nothing."""
    if watch is None:
        return False
    if watch.due:
        return watch.look(position.cpu().numpy()) is not None
    watch.skip()
    return False


def _tensor(frames: Sequence[NDArray[np.float32]], device: torch.device) -> Tensor:
    return torch.from_numpy(np.concatenate(frames)).to(device)


def run_to_end(
    stepper: Stepper,
    runs: Sequence[Run],
    *,
    rest: Rest | None = None,
    watches: Sequence[Watch | None] | None = None,
    on_frame: Callable[[int, NDArray[np.float32]], None],
    on_end: Callable[[int, dict[str, object]], None],
    on_step: Callable[[int, int], None] | None = None,
) -> int:
    """Step scenes together until each has ended, and hand on every frame and how each run ended.

    Args:
        stepper: as of `unroll`.
        runs: the scenes.
        rest: as of `unroll`.
        watches: likewise.
        on_frame: called with the number of a scene and its next frame [N, D] [m].
        on_end: called once for every scene with what there is to say of its end: nothing, "at_rest_from" [s], or
            "failed_at" [s] and "failure".
        on_step: called after every step with the number of steps made and the largest number to make.

    Returns:
        The number of steps made.

    Raises:
        InputError: a start that does not fit the simulator.
    """
    dt, total, steps = stepper.config.dt, max((run.num_steps for run in runs), default=0), 0
    rested = rest.rested if rest else set()
    going = {number for number, run in enumerate(runs) if run.num_steps}
    for number in sorted(set(range(len(runs))) - going):
        on_end(number, {})

    def end(number: int, ending: dict[str, object]) -> None:
        going.remove(number)
        on_end(number, ending)

    def end_rested() -> None:
        for number in sorted(going & rested):
            end(number, {"at_rest_from": (runs[number].made + steps) * dt})

    with torch.inference_mode():
        for parts in unroll(stepper, runs, rest=rest, watches=watches):
            end_rested()
            steps += 1
            for number in sorted(going):
                watch = watches[number] if watches else None
                failure = watch.failure if watch else None
                if number in parts:
                    on_frame(number, parts[number].cpu().numpy())
                elif failure is None:
                    when = (runs[number].made + steps) * dt
                    failure = Failure("not finite", when, f"positions were no longer finite at {when:.3g} s")
                if failure is not None:
                    end(number, {"failed_at": failure.time, "failure": failure.message})
                elif runs[number].num_steps == steps:
                    end(number, {})
            if on_step is not None:
                on_step(steps, total)
        end_rested()
    return steps


def rollout(
    stepper: Stepper,
    start: Trajectory,
    num_steps: int,
    *,
    given: int = 1,
    rest: Rest | None = None,
    watch: Watch | None = None,
    on_step: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Unroll a simulator from the first frames of `start`, on the device its weights are on.

    The loop ends early at the first frame that is not finite; the frames before it are returned.

    Args:
        stepper: makes one step: a simulator, or what wraps one.
        start: its first `given` frames, initial velocity, types, material and scene are used; later frames only for
            kinematic particles, whose script they are.
        num_steps: frames to add.
        given: frames of `start` that are taken as they are; the steps go on from the last of them.
        rest: by which the loop ends early when the scene has come to rest.
        watch: by which it ends early at a failure; the frame that failed is the last one.
        on_step: called with the number of steps made and `num_steps`.

    Returns:
        Up to `num_steps` + `given` frames at the simulator's time step; `provenance["wall_seconds"]` is the time of the
        loop, `provenance["failed_at"]` [s] and `provenance["failure"]` are there if it failed, and
        `provenance["at_rest_from"]` [s] if it came to rest.

    Raises:
        InputError: a start that does not fit the simulator.
    """
    return rollouts(
        stepper, [start], [num_steps], given=given, rest=rest, watches=[watch] if watch else None, on_step=on_step
    )[0]


def rollouts(
    stepper: Stepper,
    starts: Sequence[Trajectory],
    num_steps: Sequence[int],
    *,
    given: int = 1,
    rest: Rest | None = None,
    watches: Sequence[Watch | None] | None = None,
    on_step: Callable[[int, int], None] | None = None,
) -> list[Trajectory]:
    """Unroll several starts together, as `rollout` does one; each has its own number of steps, rest and end."""
    pasts = [start.position[:given].astype(np.float32) for start in starts]
    frames, endings = [list(past) for past in pasts], [dict[str, object]() for _ in starts]
    runs = [Run(start, steps, past, given - 1) for start, steps, past in zip(starts, num_steps, pasts, strict=True)]
    began = time.perf_counter()
    run_to_end(
        stepper,
        runs,
        rest=rest,
        watches=watches,
        on_frame=lambda number, frame: frames[number].append(frame),
        on_end=lambda number, ending: endings[number].update(ending),
        on_step=on_step,
    )
    how = {
        "wall_seconds": time.perf_counter() - began,
        "device": str(stepper.device),
        "num_threads": torch.get_num_threads(),
        "machine": machine_name(),
    }
    return [
        replace(
            start,
            position=np.stack(some),
            dt=stepper.config.dt,
            provenance={"solver": "gns_pl.rollout", **ending, **how},
            observables=None,
        )
        for start, some, ending in zip(starts, frames, endings, strict=True)
    ]
