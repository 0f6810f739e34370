"""The one place that calls the material point solver; it is imported here when first needed, not before."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gns_pl
from gns_pl.scene import Scene, part_from_dict
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from gns_pl.mpm import MPMConfig


def solver_config(mpm: Mapping[str, Any]) -> MPMConfig:
    """Return the solver's settings.

    Raises:
        InputError: unknown or missing keys, or values it refuses.
    """
    from gns_pl.mpm import MPMConfig

    config: MPMConfig = part_from_dict(MPMConfig, "mpm", mpm)
    return config


def run_solver(
    scene: Scene,
    mpm: Mapping[str, Any],
    *,
    frame_interval: float,
    seed: int,
    on_frame: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Simulate `scene` by the material point method; arguments as `gns_pl.mpm.simulate`.

    Raises:
        InputError: settings the solver refuses.
        SimulationError: the run became non-finite.
    """
    from gns_pl.mpm import simulate

    return simulate(scene, solver_config(mpm), frame_interval=frame_interval, seed=seed, on_frame=on_frame)


def compile_solver(scene: Scene, mpm: Mapping[str, Any], *, frame_interval: float) -> None:
    """Run one frame of `scene`, so that later runs, in any process, find the kernels compiled.

    What goes wrong here will go wrong again, and be told, in the run proper.
    """
    with contextlib.suppress(Exception):
        run_solver(scene.replace(duration=frame_interval), mpm, frame_interval=frame_interval, seed=0)


@cache
def solver_version() -> str:
    """Return the package's version and a hash of the sources that decide what a simulation gives."""
    package = Path(gns_pl.__file__).parent
    digest = hashlib.sha256()
    for path in [*sorted((package / "mpm").rglob("*.py")), package / "scene" / "filling.py"]:
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{gns_pl.__version__}+{digest.hexdigest()[:12]}"
