"""Single material point runs on demand, kept under a name that says exactly what was run."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress

from gns_pl.errors import InputError
from gns_pl.io import StorageError, read_trajectory, remove_temporary_files, write_trajectory
from gns_pl.io.lock import locked
from gns_pl.machine import machine_name
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.scene.extent import num_frames
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from gns_pl.mpm import MPMConfig


def reference_trajectory(
    scene: Scene,
    mpm: Mapping[str, Any] | MPMConfig,
    *,
    frame_interval: float,
    seed: int,
    cache_directory: str | Path,
    progress: bool = True,
) -> Trajectory:
    """Return `scene` simulated by the material point method, from the cache if this very run was made before.

    The name of the file holds a hash of scene, settings, frame interval, seed and the solver's own sources, so nothing
    out of date is ever found. `provenance["wall_seconds"]` is the time the solver took, on `provenance["num_threads"]`
    threads, without compilation and files; "cpu_seconds" is that of all threads together, whatever else runs.

    Args:
        scene: what to simulate.
        mpm: settings of the solver, as a mapping or an `MPMConfig`.
        frame_interval: time between frames [s].
        seed: of the solver's random placement.
        cache_directory: where runs are kept; made if needed.
        progress: show a bar on stderr while it runs.

    Raises:
        InputError: settings the solver refuses, frames further apart than the scene is long, or a damaged file in the
            cache.
        StorageError: the disk refuses.
        SimulationError: the run became non-finite.
    """
    num_frames(scene, frame_interval)  # refuses one that leaves nothing to run
    config = solver.solver_config(mpm) if isinstance(mpm, Mapping) else mpm
    settings = dataclasses.asdict(config)
    identity = {
        "scene": scene.to_dict(),
        "mpm": settings,
        "frame_interval": frame_interval,
        "seed": seed,
        "solver_version": solver.solver_version(settings),
    }
    key = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]
    directory = Path(cache_directory)
    path = directory / f"{scene.name}_{key}.h5"
    if path.exists():
        return _cached(path, scene)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{directory}: cannot be made ({error.strerror}).") from error
    with locked(directory / f".{path.stem}.lock") as held:
        if not path.exists():
            if held:
                remove_temporary_files(directory, path.name)
            write_trajectory(path, _run(scene, settings, frame_interval, seed, progress))
    (directory / f".{path.stem}.lock").unlink(missing_ok=True)
    return _cached(path, scene)


def _cached(path: Path, scene: Scene) -> Trajectory:
    trajectory = read_trajectory(path)
    if trajectory.scene != scene:
        raise InputError(f"{path}: holds another scene than its name says; remove it.")
    return trajectory


def _run(scene: Scene, settings: Mapping[str, Any], frame_interval: float, seed: int, progress: bool) -> Trajectory:
    with Progress(console=Console(stderr=True), disable=not progress, transient=True) as bar:
        task = bar.add_task(f"{scene.name}: material point reference", total=None)
        num_threads = solver.num_threads_alone(scene, settings)
        solver.compile_solver(scene, settings, frame_interval=frame_interval, num_threads=num_threads)
        start, busy = time.perf_counter(), time.process_time()
        trajectory = solver.run_solver(
            scene,
            settings,
            frame_interval=frame_interval,
            seed=seed,
            on_frame=lambda frame, total: bar.update(task, completed=frame + 1, total=total),
            num_threads=num_threads,
        )
        wall_seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - busy
    provenance = {
        **trajectory.provenance,
        "solver_version": solver.solver_version(settings),
        "wall_seconds": wall_seconds,
        "cpu_seconds": cpu_seconds,
        "machine": machine_name(),
    }
    return dataclasses.replace(trajectory, provenance=provenance)
