"""One file of a data set: simulated if it is not there, checked if it is, and measured."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.data.statistics import RunningStatistics
from gns_pl.errors import InputError
from gns_pl.generation import solver
from gns_pl.io import (
    FileRecord,
    file_sha256,
    open_trajectory,
    read_header,
    read_static,
    read_window,
    write_trajectory,
)
from gns_pl.scene import Scene

BLOCK_BYTES = 32 * 1024 * 1024
"""Positions measured at a time."""


@dataclass(frozen=True)
class Job:
    """What has to be at `path`.

    Attributes:
        path: of the file.
        scene: what to simulate.
        mpm: settings of the solver.
        frame_interval: time between frames [s].
        seed: of the solver's random placement.
        provenance: goes into the file beside what the solver says.
    """

    path: Path
    scene: Scene
    mpm: Mapping[str, Any]
    frame_interval: float
    seed: int
    provenance: Mapping[str, object]


@dataclass(frozen=True)
class Product:
    """A finished file and what the manifest wants to know of it.

    Attributes:
        record: its sum and sizes.
        particle_types: that occur in it.
        material_features: names of its material features.
        statistics: "velocity" and "acceleration".
        wall_seconds: that the solver took, or None if the file was there.
    """

    record: FileRecord
    particle_types: tuple[int, ...]
    material_features: tuple[str, ...]
    statistics: Mapping[str, RunningStatistics]
    wall_seconds: float | None


def produce(job: Job) -> Product:
    """Make sure that the file of `job` is there, and measure it.

    Raises:
        InputError: settings the solver refuses, or a file that holds something else; it is never overwritten.
        StorageError: the disk refuses.
        Exception: whatever the solver raises.
    """
    wall_seconds = None
    if not job.path.exists():
        start = time.perf_counter()
        trajectory = solver.run_solver(job.scene, job.mpm, frame_interval=job.frame_interval, seed=job.seed)
        wall_seconds = time.perf_counter() - start
        write_trajectory(job.path, replace(trajectory, provenance={**trajectory.provenance, **job.provenance}))
        del trajectory
    header = read_header(job.path)
    if header.scene != job.scene or header.dt != job.frame_interval:
        raise InputError(f"{job.path}: holds another scene than this data set has there; move it away.")
    return Product(
        record=FileRecord(file_sha256(job.path), header.num_frames, header.num_particles),
        particle_types=tuple(int(kind) for kind in np.unique(read_static(job.path)["particle_type"])),
        material_features=header.material_features,
        statistics=measure(job.path),
        wall_seconds=wall_seconds,
    )


def measure(path: Path) -> dict[str, RunningStatistics]:
    """Return the statistics of velocity and acceleration over a file, read block by block.

    They are those of `Trajectory.velocity` and `Trajectory.acceleration`.
    """
    header = read_header(path)
    dim, dt = header.dim, header.dt
    velocity, acceleration = RunningStatistics(dim), RunningStatistics(dim)
    last = read_static(path)["initial_velocity"].astype(np.float64)[None]
    velocity.update(last[0])
    block = max(1, BLOCK_BYTES // (8 * dim * header.num_particles))
    with open_trajectory(path) as file:
        for start in range(0, header.num_frames - 1, block):
            length = min(block, header.num_frames - 1 - start)
            position = read_window(file, start, length + 1).astype(np.float64)
            velocities = np.diff(position, axis=0) / dt
            velocity.update(velocities.reshape(-1, dim))
            velocities = np.concatenate([last, velocities])
            acceleration.update((np.diff(velocities, axis=0) / dt).reshape(-1, dim))
            last = velocities[-1:]
    return {"velocity": velocity, "acceleration": acceleration}
