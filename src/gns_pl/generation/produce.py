"""The files of one trajectory: simulated if they are not there, checked if they are, and measured."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.data.statistics import RunningStatistics, measure_motion
from gns_pl.errors import InputError
from gns_pl.generation.thinning import thin_trajectory
from gns_pl.io import (
    FileRecord,
    file_sha256,
    read_header,
    read_static,
    write_trajectory,
)
from gns_pl.metrics.observables import CELL_SPACINGS, compute_observables
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.scene.extent import num_frames
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class OutputFile:
    """A file, and which part of the simulation it holds.

    Attributes:
        path: of the file.
        every: k: it holds one of k^D points.
        offset: of the lattice it holds [D]; None where points are drawn.
        num_points: in it.
    """

    path: Path
    every: int
    offset: tuple[int, ...] | None
    num_points: int


@dataclass(frozen=True)
class Job:
    """A simulation and the files that have to be there of it.

    Attributes:
        name: of the files.
        outputs: the files.
        scene: what to simulate.
        num_points: that are simulated.
        mpm: settings of the solver.
        frame_interval: time between frames [s].
        seed: of the solver's random placement.
        device: "cpu" or "cuda".
        provenance: goes into the files beside what the solver says.
    """

    name: str
    outputs: tuple[OutputFile, ...]
    scene: Scene
    num_points: int
    mpm: Mapping[str, Any]
    frame_interval: float
    seed: int
    device: str
    provenance: Mapping[str, object]

    def is_made(self) -> bool:
        """Return whether all files are there."""
        return all(output.path.exists() for output in self.outputs)

    @property
    def bytes_per_point(self) -> int:
        """Positions of one point in all frames [bytes]."""
        return 4 * self.scene.dim * num_frames(self.scene, self.frame_interval)

    @property
    def num_bytes(self) -> int:
        """Positions of all points in all frames [bytes]: what the simulation leaves in memory."""
        return self.bytes_per_point * self.num_points

    def missing_bytes(self) -> int:
        """Return the positions in the files that are not there [bytes]."""
        return self.bytes_per_point * sum(output.num_points for output in self.outputs if not output.path.exists())


@dataclass(frozen=True)
class MeasuredFile:
    """What the manifest wants to know of a file.

    Attributes:
        record: its sum and sizes.
        particle_types: that occur in it.
        material_features: names of its material features.
        statistics: "velocity" and "acceleration".
    """

    record: FileRecord
    particle_types: tuple[int, ...]
    material_features: tuple[str, ...]
    statistics: Mapping[str, RunningStatistics]


@dataclass(frozen=True)
class Result:
    """The finished files of a simulation.

    Attributes:
        files: k → what is in the file of one of k^D points.
        wall_seconds: that the solver took, or None if the files were there.
    """

    files: Mapping[int, MeasuredFile]
    wall_seconds: float | None


def produce(job: Job) -> Result:
    """Make sure that the files of `job` are there, and measure them.

    The whole simulation is in memory until it is written: 4 D bytes per point and frame.

    Raises:
        InputError: settings the solver refuses, or a file that holds something else; it is never overwritten.
        StorageError: the disk refuses.
        Exception: whatever the solver raises.
    """
    if job.is_made():
        return measure_files(job)
    start = time.perf_counter()
    trajectory = solver.run_solver(
        job.scene, job.mpm, frame_interval=job.frame_interval, seed=job.seed, device=job.device
    )
    return store(job, trajectory, time.perf_counter() - start)


def store(job: Job, trajectory: Trajectory, wall_seconds: float) -> Result:
    """Write those files of `job` that are not there, and measure all.

    A file is the same bytes whenever it is made on a CPU, so it does not matter if a killed run has left some of them.
    Those made on a GPU agree within its rounding. Observables are those of all points, whichever are kept.

    Args:
        job: what was simulated.
        trajectory: of all points.
        wall_seconds: that the solver took.

    Raises:
        InputError: a file that holds something else.
        StorageError: the disk refuses.
    """
    for output in job.outputs:
        if not output.path.exists():
            thinned = thin_trajectory(trajectory, job.mpm, job.seed, output.every, output.offset)
            cell = CELL_SPACINGS * output.every * solver.solver_config(job.mpm).spacing
            observables = compute_observables(trajectory, cell)
            provenance = {**thinned.provenance, **job.provenance}
            write_trajectory(output.path, replace(thinned, provenance=provenance, observables=observables))
    return measure_files(job, wall_seconds)


def measure_files(job: Job, wall_seconds: float | None = None) -> Result:
    """Check and measure the files of `job`.

    Raises:
        InputError: a file that holds something else.
    """
    return Result({output.every: _measure_file(output, job) for output in job.outputs}, wall_seconds)


def _measure_file(output: OutputFile, job: Job) -> MeasuredFile:
    header, static = read_header(output.path), read_static(output.path)
    if header.scene != job.scene or header.dt != job.frame_interval:
        raise InputError(f"{output.path}: holds another scene than this data set has there; move it away.")
    wanted = output.offset and list(output.offset)
    stored = (header.provenance.get("every", 1), header.provenance.get("offset", wanted if output.every == 1 else None))
    if stored != (output.every, wanted):
        raise InputError(f"{output.path}: holds other points than this data set has there; move it away.")
    return MeasuredFile(
        record=FileRecord(file_sha256(output.path), header.num_frames, header.num_particles),
        particle_types=tuple(int(kind) for kind in np.unique(static["particle_type"])),
        material_features=header.material_features,
        statistics=measure_motion(output.path, header, static["initial_velocity"]),
    )
