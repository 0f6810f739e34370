"""Particle updates per second of the material point solver, against the number of points.

    python benchmarks/mpm.py                                                 # CPU, and GPU where there is one
    python benchmarks/mpm.py --device cuda --points 10000 100000 1000000

A block of sand of 4 points per direction and cell collapses in a box twice as wide; time is taken after compilation and
a first stretch of motion, as the median of several stretches. On a GPU there is also a row for many small scenes in one
launch. Included is all that a step takes; on a GPU, where a stretch is a number of whole frames of 2.5 ms, also the
sorting of the points and the reading of their positions and flags once in a frame. Files are not part of it.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import numba
import numpy as np

from gns_pl.mpm import MPMConfig, has_cuda
from gns_pl.mpm.grid import make_advance
from gns_pl.mpm.plan import Plan, make_plan, make_setting, make_state
from gns_pl.scene import FACES, Body, Material, Particles, Scene, Wall, fill_scene

FRAME_INTERVAL = 0.0025
SAND = Material(
    density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100, tension_cutoff=50
)


@dataclass(frozen=True)
class Row:
    """One row of the table; `points` are those of all scenes, rates are updates per second."""

    dim: int
    scenes: int
    points: int
    device: str
    threads: int
    precision: str
    median: float
    slowest: float
    fastest: float

    def __str__(self) -> str:
        spread = f"({self.slowest / 1e6:.2f}, {self.fastest / 1e6:.2f})"
        *head, rate, _, _ = astuple(self)
        cells = "  ".join(f"{value:>{width}}" for value, width in zip(head, WIDTHS, strict=True))
        return f"{cells}  {rate / 1e6:11.2f}  {spread:18}  {1e9 / rate:21.2f}"


WIDTHS = (3, 6, 8, 6, 7, 9)
HEAD = "dim  scenes    points  device  threads  precision  M updates/s  (slowest, fastest)  ns per point and step"


def make_case(dim: int, points: int, points_per_direction: int, precision: str = "float64") -> tuple[Scene, MPMConfig]:
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
        precision=precision,
    )
    return scene, config


def start(scene: Scene, config: MPMConfig, seed: int = 0) -> tuple[Plan, Particles]:
    """Fill a scene and plan its run."""
    particles = fill_scene(scene, config.spacing, jitter=config.jitter, generator=np.random.default_rng(seed))
    return make_plan(scene, particles, config, FRAME_INTERVAL), particles


def rates_of(run: Callable[[int], int], repeats: int, seconds: float) -> list[float]:
    """Return the updates per second of every stretch of about `seconds`; `run` makes n parts, returns its updates."""
    run(1)  # compiles, or loads what was compiled
    started = time.perf_counter()
    run(3)
    parts = max(1, round(3 * seconds / (time.perf_counter() - started)))
    rates = []
    for _ in range(repeats):
        started = time.perf_counter()
        updates = run(parts)
        rates.append(updates / (time.perf_counter() - started))
    return rates


def prepare_cpu(scene: Scene, config: MPMConfig, threads: int) -> tuple[int, Callable[[int], int]]:
    """Return the number of points and what makes n times ten steps."""
    plan, particles = start(scene, config)
    state = make_state(scene, particles, plan.grid, config)
    setting = make_setting(scene, plan.grid, config, plan.dt)
    advance = make_advance(config.shape, config.precision, threads > 1, config.law)
    numba.set_num_threads(threads)

    def run(parts: int) -> int:
        advance(*state, *setting, threads, 10 * parts)
        return 10 * parts * len(particles.mass)

    return len(particles.mass), run


def prepare_gpu(scene: Scene, config: MPMConfig, scenes: int) -> tuple[int, Callable[[int], int]]:
    """Return the number of points of all scenes and what makes n frames of them."""
    from gns_pl.mpm.batch import Batch

    starts = [start(scene, config, seed) for seed in range(scenes)]
    states = [make_state(scene, particles, plan.grid, config)[:8] for plan, particles in starts]
    batch = Batch([plan for plan, _ in starts], states)
    steps = [plan.steps for plan, _ in starts]
    updates = sum(plan.steps * len(particles.mass) for plan, particles in starts)

    def run(parts: int) -> int:
        for _ in range(parts):
            if batch.advance(steps).any():
                raise SystemExit("The simulation is unstable; its speed says nothing.")
            batch.places()
        return parts * updates

    return batch.num_points, run


def measure(chosen: argparse.Namespace) -> Iterator[Row]:
    """Yield the rows of the table."""
    for dim in chosen.dim:
        for precision in chosen.precision:
            for points in chosen.points if "cpu" in chosen.device else ():
                for threads in chosen.threads:
                    scene, config = make_case(dim, points, chosen.points_per_direction, precision)
                    number, run = prepare_cpu(scene, config, threads)
                    rates = rates_of(run, chosen.repeats, chosen.seconds)
                    yield Row(
                        dim, 1, number, "cpu", threads, precision, statistics.median(rates), min(rates), max(rates)
                    )
            cases = [(1, points) for points in chosen.points] + [tuple(chosen.batch)]
            for scenes, points in cases if "cuda" in chosen.device else ():
                scene, config = make_case(dim, points, chosen.points_per_direction, precision)
                number, run = prepare_gpu(scene, config, scenes)
                rates = rates_of(run, chosen.repeats, chosen.seconds)
                yield Row(dim, scenes, number, "cuda", 1, precision, statistics.median(rates), min(rates), max(rates))


def processor() -> str:
    """Name of the processor, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown processor"


def parse() -> argparse.Namespace:
    """Read the command line."""
    cores = numba.config.NUMBA_NUM_THREADS
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--dim", type=int, nargs="+", choices=(2, 3), default=[2, 3])
    parser.add_argument("--points", type=int, nargs="+", default=[1_000, 10_000, 100_000])
    parser.add_argument(
        "--device", nargs="+", choices=("cpu", "cuda"), help="default: the CPU, and a GPU if there is one"
    )
    parser.add_argument(
        "--threads",
        type=int,
        nargs="+",
        default=sorted({1, min(2, cores), cores}),
        help="on the CPU; 1, 2 and all cores",
    )
    parser.add_argument("--precision", nargs="+", choices=("float64", "float32"), default=["float64", "float32"])
    parser.add_argument(
        "--batch", type=int, nargs=2, default=(100, 10_000), metavar=("SCENES", "POINTS"), help="on a GPU"
    )
    parser.add_argument("--points-per-direction", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.3, help="length of one measured stretch")
    parser.add_argument("--csv", type=Path, help="file for the table, rates in updates per second")
    chosen = parser.parse_args()
    chosen.device = chosen.device or (["cpu", "cuda"] if has_cuda() else ["cpu"])
    if "cuda" in chosen.device and not has_cuda():
        parser.error("numba finds no CUDA device; install gns_pl[cuda] where there is a GPU, or choose --device cpu")
    if not all(1 <= threads <= cores for threads in chosen.threads):
        parser.error(f"--threads must lie between 1 and {cores}")
    return chosen


def main() -> None:
    """Print the table."""
    chosen = parse()
    where = f"{processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    if "cuda" in chosen.device:
        from gns_pl.mpm.batch import gpu_name

        where += f"; {gpu_name()}"
    print(
        f"{where}; Python {platform.python_version()}, numba {numba.__version__}; {chosen.points_per_direction} points "
        f"per direction; median of {chosen.repeats} stretches of {chosen.seconds:g} s"
    )
    print(HEAD)
    rows = []
    for row in measure(chosen):
        print(row, flush=True)
        rows.append(asdict(row))
    if chosen.csv and rows:
        with chosen.csv.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, rows[0])
            table.writeheader()
            table.writerows(rows)


if __name__ == "__main__":
    main()
