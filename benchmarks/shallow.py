"""Depth-averaged flow beside the material point method on the paper's two columns: errors and processor time.

    python benchmarks/shallow.py              # half a minute on one core; prints the tables of docs/shallow.md

Fronts and heights are compared with the curves in tests/validation/ref (plane strain on 1/144 m, the paper's rough
side walls on 1/48 m), the deposit's profile with plane strain run here on 1/48 m.
"""

from __future__ import annotations

import csv
import math
import statistics
import time
from pathlib import Path

import numpy as np

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.measures import arrest_time
from gns_pl.mpm import MPMConfig
from gns_pl.mpm import simulate as simulate_mpm
from gns_pl.scene import FACES, Material, Scene, Wall, column_collapse
from gns_pl.shallow import ShallowConfig, simulate
from gns_pl.trajectory import Trajectory

REFERENCES = Path(__file__).parents[1] / "tests" / "validation" / "ref"
SAND = Material(
    density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100, tension_cutoff=50
)
FRICTION, SLIP = Wall("friction", 0.385), Wall("slip")
LENGTH = {0.8: 0.475, 2.0: 0.3}
"""Aspect ratio → L0 [m]."""
FRAME_INTERVAL = 0.02
"""[s]"""
MAP_CELL = 1 / 12
"""Cells on which the deposits' volumes are compared [m]."""
CELL = 1 / 48
"""Cells of the layer [m]."""
STRENGTH = SAND.tan_friction_angle
SETTINGS = {
    "as it is": ShallowConfig(CELL),
    "rain above a = 1": ShallowConfig(CELL, rain=1.0),
    "k = 0.5": ShallowConfig(CELL, earth_pressure=0.5),
    "tan δ = tan φ": ShallowConfig(CELL, friction=STRENGTH),
    "tan δ = tan φ, rain": ShallowConfig(CELL, friction=STRENGTH, rain=1.0),
}


def column(aspect_ratio: float, walls: str) -> Scene:
    """Return a column in a box long enough for every front; `walls` is "plane" (two dimensions) or "friction"."""
    length = LENGTH[aspect_ratio]
    height = aspect_ratio * length
    domain = (12 * length, 1.2 * height) if walls == "plane" else (12 * length, 0.5, 1.2 * height)
    return column_collapse(
        domain=domain,
        length=length,
        height=height,
        gravity=9.81,
        duration=8 * math.sqrt(height / 9.81),
        material=SAND,
        walls={face: SLIP if face[0] == "z" and face[1] == "+" else FRICTION for face in FACES[len(domain)]},
    )


def reference(aspect_ratio: float, walls: str) -> dict[str, np.ndarray]:
    """Return the curves of the reference, name → [T]."""
    path = REFERENCES / f"mpm_{walls}_{aspect_ratio:g}.csv"
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def volume_map(run: Trajectory) -> np.ndarray:
    """Return the volume of the last frame in cells of `MAP_CELL` along x, linearly shared [B] [m²]."""
    place = run.position[-1, :, 0].astype(np.float64) / MAP_CELL
    node = np.floor(place).astype(int)
    share, volume = place - node, run.volume().astype(np.float64)
    number = int(run.scene.upper[0] / MAP_CELL) + 2
    found = np.bincount(node, volume * (1 - share), number) + np.bincount(node + 1, volume * share, number)
    return np.asarray(found / found.sum())


def processor_time(scene: Scene, config: ShallowConfig) -> float:
    """Return the median processor time of five warm runs, particles included [s]."""
    times = []
    for _ in range(5):
        start = time.process_time()
        simulate(scene, config, frame_interval=FRAME_INTERVAL)
        times.append(time.process_time() - start)
    return statistics.median(times)


def main() -> None:
    """Print one table for each kind of side walls."""
    mpm = MPMConfig(1 / 48, 2, 0.5, "affine_flip", 20.0, 0.86, 0.0)
    maps = {
        ratio: volume_map(simulate_mpm(column(ratio, "plane"), mpm, frame_interval=FRAME_INTERVAL)) for ratio in LENGTH
    }
    for walls in ("plane", "friction"):
        print(f"\n| {walls} | a | runout 99 % [L0] | error | mean height | profile | arrest [τc] | processor s |")
        print("|---|---|---|---|---|---|---|---|")
        for ratio in LENGTH:
            truth = reference(ratio, walls)
            scene = column(ratio, walls)
            end, height = truth["runout_99"][-1], truth["mean_height"][-1]
            rest = arrest_time(truth["time_tau"], truth["runout_99"])
            print(f"| MPM | {ratio:g} | {end:.3f} | | {height:.3f} L0 | | {rest:.2f} | |")
            for name, config in SETTINGS.items():
                run = simulate(scene, config, frame_interval=FRAME_INTERVAL)
                curves = compute_curves(run)
                own, own_height = curves["runout_99"][-1], curves["mean_height"][-1] / LENGTH[ratio]
                misplaced = 0.5 * np.abs(volume_map(run) - maps[ratio]).sum() if walls == "plane" else math.nan
                own_rest = arrest_time(curves["time_tau"], curves["runout_99"])
                print(
                    f"| {name} | {ratio:g} | {own:.3f} | {100 * (own / end - 1):+.0f} % | "
                    f"{100 * (own_height / height - 1):+.0f} % | {'–' if walls != 'plane' else f'{misplaced:.3f}'} | "
                    f"{own_rest:.2f} | {processor_time(scene, config):.3f} |"
                )


if __name__ == "__main__":
    main()
