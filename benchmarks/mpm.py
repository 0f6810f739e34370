"""Particle updates per second of the material point solver, against the number of points, on one thread.

    python benchmarks/mpm.py --dim 3 --points 1000 10000 100000

A block of sand of 4 points per direction and cell collapses in a box twice as wide; time is taken after compilation and
a first stretch of motion, as the median of several stretches. Files and frames are not part of it.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from pathlib import Path

import numba
import numpy as np

from gns_pl.mpm import MPMConfig
from gns_pl.mpm.grid import advance
from gns_pl.mpm.solver import largest_speed, make_grid, make_setting, make_state, num_steps_per_frame
from gns_pl.scene import FACES, Body, Material, Scene, Wall, fill_scene

SAND = Material(
    density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100, tension_cutoff=50
)


def make_case(dim: int, points: int, points_per_direction: int) -> tuple[Scene, MPMConfig]:
    """A square (cube) of 0.5 m in a box of 1 m, with the cell size that gives about `points` material points."""
    walls = dict.fromkeys(FACES[dim], Wall("friction", 0.385))
    body = Body((0.0,) * dim, (0.5,) * dim, (0.0,) * dim)
    gravity = (0.0,) * (dim - 1) + (-9.81,)
    scene = Scene("benchmark", (0.0,) * dim, (1.0,) * dim, gravity, 1.0, {"sand": SAND}, (body,), walls)
    spacing = 0.5 / round(points ** (1 / dim))
    config = MPMConfig(
        cell_size=spacing * points_per_direction,
        points_per_direction=points_per_direction,
        courant=0.3,
        transfer="affine_flip",
        damping_rate=20.0,
        bulk_viscosity=0.3,
        jitter=0.5,
    )
    return scene, config


def measure(dim: int, points: int, points_per_direction: int, repeats: int, seconds: float) -> tuple[int, list[float]]:
    """Return the number of points and the updates per second of every stretch of about `seconds`."""
    scene, config = make_case(dim, points, points_per_direction)
    grid = make_grid(scene, config.cell_size)
    particles = fill_scene(scene, config.spacing, jitter=config.jitter, generator=np.random.default_rng(0))
    steps = num_steps_per_frame(scene, config, grid, largest_speed(scene, particles), 0.0025)
    state = make_state(scene, particles, grid, config)
    setting = make_setting(scene, grid, config, 0.0025 / steps)
    advance(*state, *setting, 1, 1)  # compiles, or loads what was compiled
    number = len(particles.mass)
    started = time.perf_counter()
    advance(*state, *setting, 1, 20)
    num_steps = max(1, round(20 * seconds / (time.perf_counter() - started)))
    rates = []
    for _ in range(repeats):
        started = time.perf_counter()
        advance(*state, *setting, 1, num_steps)
        rates.append(number * num_steps / (time.perf_counter() - started))
    return number, rates


def processor() -> str:
    """Name of the processor, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown processor"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--dim", type=int, nargs="+", choices=(2, 3), default=[2, 3])
    parser.add_argument("--points", type=int, nargs="+", default=[1_000, 10_000, 100_000])
    parser.add_argument("--points-per-direction", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.5, help="length of one measured stretch")
    chosen = parser.parse_args()
    print(
        f"{processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; Python {platform.python_version()}, "
        f"numba {numba.__version__}; float64, one thread; {chosen.points_per_direction} points per direction; "
        f"median of {chosen.repeats} stretches of {chosen.seconds:g} s"
    )
    print("dim   points   M updates/s   (slowest, fastest)   ns per point and step")
    for dim in chosen.dim:
        for points in chosen.points:
            number, rates = measure(dim, points, chosen.points_per_direction, chosen.repeats, chosen.seconds)
            middle = statistics.median(rates)
            spread = f"({min(rates) / 1e6:.2f}, {max(rates) / 1e6:.2f})"
            print(f"{dim:3d} {number:8d} {middle / 1e6:13.2f}   {spread:18s} {1e9 / middle:23.0f}", flush=True)


if __name__ == "__main__":
    main()
