"""What ground costs in a step: a heap on the floor of its box, on a flat terrain, and on a plane at the floor's height.

    python benchmarks/ground_cost.py               # prints a table; the sentence in docs/terrain.md was typed from it
    python benchmarks/ground_cost.py --turns 9

All three run in turns, so that what else the machine does slows all alike; times are processor times of one thread,
after a first frame that loads what is compiled. Given is the median over the turns of the ratio of a turn.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

import gns_pl
from gns_pl.scene import FACES, Body, Material, Plane, Scene, Terrain, Wall
from gns_pl.solvers.solver import Solver

SAND = Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30)
ROUGH = Wall("friction", 0.385)
SIZE, HEAP, DURATION, INTERVAL = (1.25, 1.25, 0.40625), (0.4, 0.4, 0.25), 0.2, 0.02
SOLVERS = {"MPM on 1/32 m": ("mpm", 1 / 32), "shallow-k0": ("shallow-k0", None)}


def grounds() -> dict[str, Scene]:
    """Return the heap on each ground, away from the middle, so that no mirror makes less of it."""
    walls = dict.fromkeys(FACES[3], ROUGH)
    body = Body((0.3, 0.35, 0.0), HEAP, (0.0, 0.0, 0.0))
    floor = Scene("floor", (0.0,) * 3, SIZE, (0.0, 0.0, -9.81), DURATION, {"sand": SAND}, (body,), walls)
    cell = 1 / 64  # about those that depth-averaged flow has without a terrain
    heights = np.zeros([round(edge / cell) for edge in SIZE[:2]])
    terrain = Terrain(heights, (cell / 2, cell / 2), cell, ROUGH)
    plane = Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), wall=ROUGH)
    below = floor.replace(lower=(0.0, 0.0, -0.0625))  # two cells of MPM under the ground
    return {"floor": floor, "terrain": below.replace(terrain=terrain), "plane": below.replace(obstacles=(plane,))}


def measured(solver: Solver, scene: Scene) -> tuple[float, int, int]:
    """Return the processor time of a run [s], its particles and its steps."""
    began = time.process_time()
    run = solver.run(scene, interval=INTERVAL)
    return time.process_time() - began, run.num_particles, int(str(run.provenance["num_steps"]))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    turns = parser.parse_args().turns
    print("| solver | ground | particles | steps | time [s] | over the floor |\n|---|---|---|---|---|---|")
    for name, (solver_name, cell_size) in SOLVERS.items():
        solver = gns_pl.load_solver(solver_name, cell_size=cell_size)
        scenes = {key: scene for key, scene in grounds().items() if solver.unsupported_reason(scene) is None}
        for scene in scenes.values():
            solver.run(scene.replace(duration=INTERVAL), interval=INTERVAL)
        rows = [{key: measured(solver, scene) for key, scene in scenes.items()} for _ in range(turns)]
        for key in scenes:
            seconds = statistics.median(row[key][0] for row in rows)
            ratio = statistics.median(row[key][0] / row["floor"][0] for row in rows)
            print(f"| {name} | {key} | {rows[0][key][1]:,} | {rows[0][key][2]:,} | {seconds:.2f} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
