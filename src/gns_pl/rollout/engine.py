"""The plain loop: step, append, repeat. What accelerates it later must agree with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from gns_pl.errors import InputError
from gns_pl.graph import Static
from gns_pl.simulator import Simulator
from gns_pl.trajectory import Trajectory, ballistic_history


def static_of(trajectory: Trajectory) -> Static:
    """Return the time-independent tensors of one trajectory, B = 1."""
    scene = trajectory.scene
    return Static(
        particle_type=torch.from_numpy(trajectory.particle_type),
        material=torch.from_numpy(trajectory.material),
        volume=torch.from_numpy(trajectory.volume()),
        lower=torch.tensor([scene.lower], dtype=torch.float32),
        upper=torch.tensor([scene.upper], dtype=torch.float32),
        gravity=torch.tensor([scene.gravity], dtype=torch.float32),
        batch=torch.zeros(trajectory.num_particles, dtype=torch.int64),
    )


def rollout(
    simulator: Simulator,
    start: Trajectory,
    num_steps: int,
    *,
    on_step: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Unroll `simulator` from the first frame of `start`, on the device its weights are on.

    The history before the first frame is ballistic (x0 − k v0 Δt), so a scene alone is enough to start from. The loop
    ends early at the first frame that is not finite; the frames before it are returned.

    Args:
        simulator: makes one step.
        start: its first frame, initial velocity, types, material and scene are used; later frames only for kinematic
            particles, whose script they are.
        num_steps: frames to add.
        on_step: called with the number of steps made and `num_steps`.

    Returns:
        Up to `num_steps` + 1 frames at the simulator's time step; `provenance["wall_seconds"]` is the time of the loop,
        `provenance["failed_at"]` [s] is there if it ended early.

    Raises:
        InputError: a start that does not fit the simulator.
    """
    config = simulator.config
    if start.scene.dim != config.dim:
        raise InputError(f"this simulator has {config.dim} dimensions, scene {start.scene.name!r} {start.scene.dim}.")
    if start.scene.obstacles:
        raise InputError(f"scene {start.scene.name!r} has obstacles, and a learned simulator knows no obstacles yet.")
    if start.material_features[: len(config.material_features)] != config.material_features:
        raise InputError(
            f"this simulator needs the material features {list(config.material_features)}, "
            f"not {list(start.material_features)}."
        )
    unknown = sorted(set(np.unique(start.particle_type).tolist()) - set(config.particle_types))
    if unknown:
        raise InputError(f"particle types {unknown} were not in the simulator's data.")
    device = simulator.velocity_scale.device
    static = static_of(start).to(device)
    scripted = ~static.moved.cpu().numpy()
    if scripted.any() and (start.num_frames <= num_steps or not np.isclose(start.dt, config.dt)):
        raise InputError("kinematic particles need a script: positions in every frame at the simulator's time step.")
    past = ballistic_history(start.position[0], start.initial_velocity, config.dt, config.input_sequence_length)
    history = torch.from_numpy(past).transpose(0, 1).contiguous().to(device, torch.float32)
    frames = [start.position[0].astype(np.float32)]
    provenance: dict[str, object] = {"solver": "gns_pl.rollout"}
    began = time.perf_counter()
    with torch.inference_mode():
        for step in range(1, num_steps + 1):
            position = simulator(history, static)
            if scripted.any():
                position[~static.moved] = torch.from_numpy(start.position[step][scripted]).to(device)
            frame = position.cpu().numpy()
            if not np.isfinite(frame).all():
                provenance["failed_at"] = step * config.dt
                break
            frames.append(frame)
            history = torch.cat([history[:, 1:], position[:, None]], dim=1)
            if on_step is not None:
                on_step(step, num_steps)
    provenance["wall_seconds"] = time.perf_counter() - began
    provenance["device"] = str(device)
    provenance["num_threads"] = torch.get_num_threads()
    return replace(start, position=np.stack(frames), dt=config.dt, provenance=provenance)
