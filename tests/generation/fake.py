"""A solver that needs no physics, small specifications, and a program that generates with them until it is killed.

Run as `python -m tests.generation.fake ROOT NUM_WORKERS SECONDS [FILE_LIMIT]`: every simulation takes SECONDS more, and
no file may grow beyond FILE_LIMIT bytes. Spawned processes import this module again, so they get the same solver.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.errors import report_input_errors
from gns_pl.generation import generate_dataset
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene, fill_scene
from gns_pl.trajectory import Trajectory, start_trajectory

MPM = {
    "cell_size": 0.25,
    "points_per_direction": 2,
    "courant": 0.3,
    "transfer": "affine_flip",
    "damping_rate": 20,
    "bulk_viscosity": 0.3,
    "jitter": 0.5,
}
MATERIAL = {"density": 1800, "youngs_modulus": 2e6, "poisson_ratio": 0.3, "friction_angle_deg": 30, "cohesion": 100}
WALLS = {f"{axis}{side}": {"condition": "friction", "friction": 0.385} for axis in "xyz" for side in "-+"}
DROPS = {
    "count": 5,
    "valid": 1,
    "test": 1,
    "duration": 0.06,
    "domain": [1.0, 1.0, 1.0],
    "side": [0.25, 0.4],
    "speed": 1.5,
    "max_drop": 0.3,
}
BLOCKS = {
    "kind": "block_release",
    "count": 3,
    "valid": 1,
    "duration": 0.06,
    "domain": [1.0, 1.0, 1.0],
    "length": [0.3, 0.5],
    "aspect_ratio": [0.4, 0.7],
    "at_wall": 0.5,
}


FINE = {**MPM, "cell_size": 0.125}
"""With it the bodies of `make_spec` have 2 to 8 places along each axis."""


def make_spec(**changes: Any) -> dict[str, Any]:
    """Return a small specification: five drops and three blocks of seven frames."""
    spec = {
        "name": "small",
        "seed": 7,
        "frame_interval": 0.01,
        "mpm": dict(MPM),
        "material": dict(MATERIAL),
        "walls": dict(WALLS),
        "gravity": 9.81,
        "families": {"cube_drop": dict(DROPS), "low": dict(BLOCKS)},
    }
    return {**spec, **changes}


def make_thinned_spec(**changes: Any) -> dict[str, Any]:
    """Return `make_spec` on a fine grid, of which every 2nd and every 3rd point are stored."""
    return make_spec(mpm=dict(FINE), store_every=[2, 3], **changes)


def fake_solver(
    scene: Scene,
    mpm: Mapping[str, Any],
    *,
    frame_interval: float,
    seed: int,
    on_frame: Callable[[int, int], None] | None = None,
    device: str = "cpu",
    num_threads: int = 1,
) -> Trajectory:
    """Move every particle freely under gravity until the floor stops it."""
    spacing = mpm["cell_size"] / mpm["points_per_direction"]
    particles = fill_scene(scene, spacing, jitter=mpm["jitter"], generator=np.random.default_rng(seed))
    num_frames = round(scene.duration / frame_interval) + 1
    time_ = np.arange(num_frames)[:, None, None] * frame_interval
    position = particles.position + time_ * particles.velocity + 0.5 * time_**2 * np.array(scene.gravity)
    if on_frame is not None:
        on_frame(num_frames - 1, num_frames)
    start = start_trajectory(scene, particles, frame_interval, {"solver": "fake", "seed": seed})
    return replace(start, position=np.clip(position, scene.lower, scene.upper).astype(np.float32))


def fake_batch(
    scenes: Sequence[Scene], mpm: Mapping[str, Any], *, frame_interval: float, seeds: Sequence[int]
) -> list[Trajectory]:
    """Run `fake_solver` on many scenes."""
    pairs = zip(scenes, seeds, strict=True)
    return [fake_solver(scene, mpm, frame_interval=frame_interval, seed=seed) for scene, seed in pairs]


def _slow_solver(scene: Scene, mpm: Mapping[str, Any], **rest: Any) -> Trajectory:
    time.sleep(float(sys.argv[3]))
    return fake_solver(scene, mpm, **rest)


if __name__ in {"__main__", "__mp_main__"}:
    solver.run_solver = _slow_solver

if __name__ == "__main__":
    if len(sys.argv) > 4:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[4]),) * 2)
    with report_input_errors("fake.py"):
        generate_dataset(make_spec(), root=Path(sys.argv[1]), num_workers=int(sys.argv[2]))
