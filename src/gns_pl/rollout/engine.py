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
from gns_pl.graph import SceneBatch
from gns_pl.machine import machine_name
from gns_pl.models.config import SimulatorConfig
from gns_pl.rollout.failure import Watch
from gns_pl.rollout.rest import Rest
from gns_pl.rollout.stepper import Stepper
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


def static_of(*trajectories: Trajectory) -> SceneBatch:
    """Return the time-independent tensors of trajectories, one scene each."""
    scenes = [trajectory.scene for trajectory in trajectories]
    numbers = torch.tensor([trajectory.num_particles for trajectory in trajectories])
    return SceneBatch(
        particle_type=torch.cat([torch.from_numpy(trajectory.particle_type) for trajectory in trajectories]),
        material=torch.cat([torch.from_numpy(trajectory.material) for trajectory in trajectories]),
        volume=torch.cat([torch.from_numpy(trajectory.volume()) for trajectory in trajectories]),
        lower=torch.tensor([scene.lower for scene in scenes], dtype=torch.float32),
        upper=torch.tensor([scene.upper for scene in scenes], dtype=torch.float32),
        gravity=torch.tensor([scene.gravity for scene in scenes], dtype=torch.float32),
        batch=torch.arange(len(scenes)).repeat_interleave(numbers),
    )


def history_of(run: Run, config: SimulatorConfig, frames: int = 0) -> Tensor:
    """Return the positions a step needs [N, H, D] [m].

    Before the first frame they are ballistic (x0 − k v0 Δt), so that a scene alone is enough to start from.

    Args:
        run: the scene.
        config: of the simulator.
        frames: that are wanted, if more than H: of those before, the ones that were never made are NaN.
    """
    length, start = config.input_sequence_length, run.start
    recent = start.position[:1] if run.past is None else run.past[-max(length, frames) :]
    before = ballistic_history(start.position[0], start.initial_velocity, config.dt, length)[:-1]
    # A run that goes on early still looks back before its first frame, as the single run does.
    positions = np.concatenate([before, recent])[-max(length, frames) :]
    missing = np.full((max(0, frames - len(positions)), *recent.shape[1:]), np.nan)
    positions = np.concatenate([missing, positions]).astype(np.float32)
    return torch.from_numpy(positions).transpose(0, 1).contiguous()


def check_run(run: Run, config: SimulatorConfig) -> None:
    """Raise an `InputError` if a start does not fit the simulator."""
    start = run.start
    if start.scene.dim != config.dim:
        raise InputError(f"this simulator has {config.dim} dimensions, scene {start.scene.name!r} {start.scene.dim}.")
    if start.scene.obstacles:
        raise InputError(f"scene {start.scene.name!r} has obstacles, and a learned simulator knows no obstacles yet.")
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
        scenes = static_of(*(runs[number].start for number in active)).to(device)
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
        loop, `provenance["failed_at"]` [s] is there if it ended early, with `provenance["failure"]` if it was watched,
        `provenance["at_rest_from"]` if at rest.

    Raises:
        InputError: a start that does not fit the simulator.
    """
    past, finite = start.position[:given].astype(np.float32), True
    frames = list(past)
    began = time.perf_counter()
    with torch.inference_mode():
        for parts in unroll(stepper, [Run(start, num_steps, past, given - 1)], rest=rest, watches=[watch]):
            finite = 0 in parts
            if finite:
                frames.append(parts[0].cpu().numpy())
                if on_step is not None:
                    on_step(len(frames) - given, num_steps)
    provenance: dict[str, object] = {"solver": "gns_pl.rollout"}
    if watch is not None and watch.failure is not None:
        provenance |= {"failed_at": watch.failure.time, "failure": watch.failure.message}
    elif not finite:
        provenance["failed_at"] = len(frames) * stepper.config.dt
    elif len(frames) < num_steps + given:
        provenance["at_rest_from"] = (len(frames) - 1) * stepper.config.dt
    provenance["wall_seconds"] = time.perf_counter() - began
    provenance["device"] = str(stepper.device)
    provenance["num_threads"] = torch.get_num_threads()
    provenance["machine"] = machine_name()
    return replace(start, position=np.stack(frames), dt=stepper.config.dt, provenance=provenance)
