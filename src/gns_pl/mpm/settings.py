"""The one place that calls the material point solver; it is imported here when first needed, not before."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gns_pl
from gns_pl.errors import InputError
from gns_pl.machine import available_cores
from gns_pl.scene import Particles, Scene, fill_scene, part_from_dict
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from gns_pl.mpm import MPMConfig
    from gns_pl.mpm.stepping import SteppedRun

DEVICES = ("auto", "cpu", "cuda")

LARGE = 5_000
"""From so many points on the threads of one run gain more than their waiting for each other costs."""


def choose_device(device: str) -> str:
    """Return "cpu" or "cuda": what is asked for, with "auto" the GPU where there is one.

    Raises:
        InputError: an unknown device, or "cuda" where numba finds none.
    """
    if device not in DEVICES:
        raise InputError(f"device must be one of {', '.join(DEVICES)}, not {device!r}.")
    if device == "cpu":
        return device
    from gns_pl.mpm import has_cuda

    found = has_cuda()
    if device == "cuda" and not found:
        raise InputError("device=cuda: numba finds no CUDA device here; choose device=cpu, or auto.")
    return "cuda" if found else "cpu"


def solver_config(mpm: Mapping[str, Any]) -> MPMConfig:
    """Return the solver's settings.

    Raises:
        InputError: unknown or missing keys, or values it refuses.
    """
    from gns_pl.mpm import MPMConfig

    config: MPMConfig = part_from_dict(MPMConfig, "mpm", mpm)
    return config


def place_points(scene: Scene, mpm: Mapping[str, Any], seed: int) -> Particles:
    """Return the points from which a run of `scene` starts, in their order in its trajectory.

    Raises:
        InputError: settings the solver refuses.
    """
    from gns_pl.mpm.solver import start_points

    return start_points(scene, solver_config(mpm), seed)


def run_solver(
    scene: Scene,
    mpm: Mapping[str, Any],
    *,
    frame_interval: float,
    seed: int,
    on_frame: Callable[[int, int], None] | None = None,
    device: str = "cpu",
    num_threads: int = 1,
) -> Trajectory:
    """Simulate `scene` by the material point method; arguments as `gns_pl.mpm.simulate`.

    Raises:
        InputError: settings the solver refuses.
        SimulationError: the run became non-finite.
    """
    from gns_pl.mpm import simulate

    config = solver_config(mpm)
    return simulate(
        scene,
        config,
        frame_interval=frame_interval,
        seed=seed,
        on_frame=on_frame,
        device=device,
        num_threads=num_threads,
    )


def stepped_run(scene: Scene, mpm: Mapping[str, Any], particles: Particles, interval: float) -> SteppedRun:
    """Return a run that stops at every frame; arguments as `gns_pl.mpm.stepping.SteppedRun`.

    Raises:
        InputError: settings the solver refuses.
    """
    from gns_pl.mpm.stepping import SteppedRun

    return SteppedRun(scene, solver_config(mpm), particles, interval)


def num_threads_alone(scene: Scene, mpm: Mapping[str, Any]) -> int:
    """Return how many threads a run of `scene` should have if nothing else runs: all cores, unless it is small.

    The result does not depend on it, only the time.
    """
    import numba

    num_points = len(fill_scene(scene, solver_config(mpm).spacing).position)
    asked = os.environ.get("OMP_NUM_THREADS", "")  # what limits the threads of most libraries limits these too
    cores = min(available_cores(), int(numba.config.NUMBA_NUM_THREADS), int(asked) if asked.isdigit() else sys.maxsize)
    return cores if num_points >= LARGE else 1


def run_batch(
    scenes: Sequence[Scene], mpm: Mapping[str, Any], *, frame_interval: float, seeds: Sequence[int]
) -> list[Trajectory]:
    """Simulate many scenes at once on the GPU; arguments as `gns_pl.mpm.simulate_batch`.

    Raises:
        InputError: settings the solver refuses.
        SimulationError: one of the runs became non-finite.
    """
    from gns_pl.mpm import simulate_batch

    return simulate_batch(scenes, solver_config(mpm), frame_interval=frame_interval, seeds=seeds)


def compile_solver(scene: Scene, mpm: Mapping[str, Any], *, frame_interval: float, num_threads: int = 1) -> None:
    """Run one frame of `scene`, so that later runs, in any process, find the kernels compiled.

    What goes wrong here will go wrong again, and be told, in the run proper.
    """
    with contextlib.suppress(Exception):
        run_solver(
            scene.replace(duration=frame_interval), mpm, frame_interval=frame_interval, seed=0, num_threads=num_threads
        )


def solver_version(mpm: Mapping[str, Any] | None = None) -> str:
    """Return the package's version and a hash of the sources that decide what a simulation gives.

    Args:
        mpm: settings of the solver; a material law of one's own among them adds a hash of its code.

    Raises:
        InputError: an unknown law.
    """
    law = law_digest(mpm or {})
    return _own_version() + (f".{law}" if law else "")


def law_digest(mpm: Mapping[str, Any]) -> str:
    """Return the hash of the code of a material law of one's own; "" for the shipped law.

    Args:
        mpm: settings of the solver.

    Raises:
        InputError: an unknown law.
    """
    from gns_pl.mpm.laws import DRUCKER_PRAGER, find_law

    law = find_law(mpm.get("law", DRUCKER_PRAGER))
    return law.digest if law else ""


@cache
def _own_version() -> str:
    package = Path(gns_pl.__file__).parent
    digest = hashlib.sha256()
    filling = [package / "scene" / f"{name}.py" for name in ("filling", "release", "terrain")]
    for path in [*sorted((package / "mpm").rglob("*.py")), *filling]:
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{gns_pl.__version__}+{digest.hexdigest()[:12]}"
