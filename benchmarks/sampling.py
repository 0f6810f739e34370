"""How well the points that are kept of a fine run stand for all of its points, by the way they are chosen.

    python benchmarks/sampling.py               # docs/sampling.csv, some 10 minutes on one core
    python benchmarks/sampling.py --plane-only  # two dimensions alone, a minute

Columns between rough walls and in plane strain are run by the material point method as the data sets `collapse` and
`collapse_plane` are, k = 3. Of the last frame: the 99 % front's advance, the map of the volume on a grid of two coarse
spacings, and the mean height, those of the kept points against those of all points of the same run. A row is a column
and a way to choose; its bias is the mean over all placements and draws, its scatter the standard deviation.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.generation.thinning import drawn_points, kept_points
from gns_pl.io.tables import write_table
from gns_pl.metrics.maps import map_error, volume_map
from gns_pl.metrics.measures import centre_of_mass
from gns_pl.metrics.release import front_advance
from gns_pl.mpm import settings as solver
from gns_pl.presets import preset
from gns_pl.scene import Material, Particles, Scene, Wall, column_collapse
from gns_pl.trajectory import Trajectory

TABLE = Path(__file__).parents[1] / "docs" / "sampling.csv"
EVERY = 3
DRAWS = 100
"""Of each placement, where points are drawn."""
PLACEMENTS = {2: 6, 3: 3}
"""D → runs of a column, each with its points jittered by another seed."""
COLUMNS = {2: (0.5, 0.8, 2.0, 4.0), 3: (0.8, 2.0)}
"""D → aspect ratios H0 / L0."""
AREA = 0.18
"""L0 · H0 of every column [m²]."""
DURATION = 8.0
"""In √(H0/g)."""

Chosen = Iterator[Trajectory]


@dataclass(frozen=True)
class Row:
    """One column and one way to choose.

    Attributes:
        dim: D.
        aspect_ratio: H0 / L0.
        points: of the fine run.
        kept: points in the mean.
        way: how they are chosen.
        samples: placements times draws.
        front: bias of the 99 % front's advance over that of all points, in per cent.
        front_scatter: its standard deviation, in per cent.
        map: mean share of the volume in the wrong place.
        map_of_mean: the same of the mean map over all samples, which is what is wrong whatever the draw.
        height: bias of the mean height, in per cent.
        height_scatter: its standard deviation, in per cent.
    """

    dim: int
    aspect_ratio: float
    points: int
    kept: float
    way: str
    samples: int
    front: float
    front_scatter: float
    map: float
    map_of_mean: float
    height: float
    height_scatter: float


def make_scene(data: dict[str, Any], dim: int, aspect_ratio: float) -> Scene:
    """Return a column of the data's material and walls in a box that its front does not cross."""
    length = math.sqrt(AREA / aspect_ratio)
    height = aspect_ratio * length
    return column_collapse(
        domain=(2.5, 1.1) if dim == 2 else (2.0, 0.5, 0.75),
        length=length,
        height=height,
        gravity=data["gravity"],
        duration=DURATION * math.sqrt(height / data["gravity"]),
        material=Material(**data["material"]),
        walls={face: Wall(**wall) for face, wall in data["walls"].items()},
        name=f"column_{aspect_ratio:g}",
    )


def of_lattice(ends: Trajectory, particles: Particles) -> Chosen:
    """Yield every one of the k^D lattices."""
    for offset in product(range(EVERY), repeat=ends.scene.dim):
        keep = kept_points(ends.scene, particles, EVERY, offset)
        yield part(ends, keep, np.full(len(keep), ends.mass.sum(dtype=np.float64) / len(keep)))


def of_middle_lattice(ends: Trajectory, particles: Particles) -> Chosen:
    """Yield the one that evaluations of models of such data place."""
    keep = kept_points(ends.scene, particles, EVERY, [(EVERY - 1) // 2] * ends.scene.dim)
    yield part(ends, keep, np.full(len(keep), ends.mass.sum(dtype=np.float64) / len(keep)))


def of_blocks(ends: Trajectory, particles: Particles) -> Chosen:
    """Yield one point of each block, every block by itself."""
    group = drawn_points(ends.scene, particles, EVERY, 0)[1]
    mass = np.bincount(group, weights=ends.mass)
    for seed in range(DRAWS):
        order = np.lexsort((np.random.default_rng(seed).random(len(group)), group))
        yield part(ends, order[np.unique(group[order], return_index=True)[1]], mass)


def of_dealt_blocks(ends: Trajectory, particles: Particles) -> Chosen:
    """Yield one point of each block, layers shared out among blocks side by side: what data sets have."""
    for seed in range(DRAWS):
        keep, group = drawn_points(ends.scene, particles, EVERY, seed)
        yield part(ends, keep, np.bincount(group, weights=ends.mass)[group[keep]])


def of_block_means(ends: Trajectory, particles: Particles) -> Chosen:
    """Yield the mean position of each block's points."""
    group = drawn_points(ends.scene, particles, EVERY, 0)[1]
    number = np.bincount(group)
    columns = ends.position.astype(np.float64).transpose(0, 2, 1).reshape(-1, len(group))
    means = np.stack([np.bincount(group, weights=column) / number for column in columns])
    first = np.unique(group, return_index=True)[1]
    kept = part(ends, first, np.bincount(group, weights=ends.mass))
    yield replace(kept, position=means.reshape(len(ends.position), ends.scene.dim, -1).transpose(0, 2, 1))


WAYS: dict[str, Callable[[Trajectory, Particles], Chosen]] = {
    "every third lattice point": of_lattice,
    "of these, the middle lattice": of_middle_lattice,
    "one of each block, drawn alone": of_blocks,
    "one of each block, layers dealt": of_dealt_blocks,
    "block means": of_block_means,
}


def part(ends: Trajectory, keep: Any, mass: Any) -> Trajectory:
    """Return some particles of a trajectory with other masses [kg]."""
    return replace(
        ends,
        position=ends.position[:, keep],
        particle_type=ends.particle_type[keep],
        material=ends.material[keep],
        mass=mass,
        initial_velocity=ends.initial_velocity[keep],
    )


def measured(ends: Trajectory, cell: float) -> tuple[float, float, Any]:
    """Return the front's advance [m], the mean height [m] and the volume map of the last frame."""
    position, volume = ends.position[-1].astype(np.float64), ends.volume().astype(np.float64)
    height = float(centre_of_mass(ends)[-1, -1])
    return float(front_advance(ends)[-1]), height, volume_map(position, volume, ends.scene, cell)


def rows_of(dim: int, aspect_ratio: float) -> list[Row]:
    """Run a column from every placement and return a row for each way to choose."""
    data = preset("data/collapse" if dim == 3 else "data/collapse_plane")
    mpm, scene = data["mpm"], make_scene(data, dim, aspect_ratio)
    cell = 2 * EVERY * solver.solver_config(mpm).spacing
    seen: dict[str, list[tuple[float, float, float, Any]]] = {way: [] for way in WAYS}
    kept: dict[str, list[int]] = {way: [] for way in WAYS}
    all_maps = []
    for seed in range(PLACEMENTS[dim]):
        whole = solver.run_solver(scene, mpm, frame_interval=0.02, seed=seed)
        ends, particles = whole.every(whole.num_frames - 1), solver.place_points(scene, mpm, seed)
        front, height, volumes = measured(ends, cell)
        all_maps.append(volumes)
        for way, choose in WAYS.items():
            for chosen in choose(ends, particles):
                own_front, own_height, own_map = measured(chosen, cell)
                errors = own_front / front - 1, own_height / height - 1, map_error(own_map, volumes)
                seen[way].append((*errors, own_map))
                kept[way].append(chosen.num_particles)
    rows = []
    for way, values in seen.items():
        fronts, heights, maps = (np.array([value[place] for value in values]) for place in range(3))
        mean_map = np.mean([value[3] for value in values], axis=0)
        rows.append(
            Row(
                dim=dim,
                aspect_ratio=aspect_ratio,
                points=ends.num_particles,
                kept=float(np.mean(kept[way])),
                way=way,
                samples=len(values),
                front=100 * float(fronts.mean()),
                front_scatter=100 * float(fronts.std()),
                map=float(maps.mean()),
                map_of_mean=map_error(mean_map, np.mean(all_maps, axis=0)),
                height=100 * float(heights.mean()),
                height_scatter=100 * float(heights.std()),
            )
        )
        print(*(f"{value:.4g}" if isinstance(value, float) else value for value in vars(rows[-1]).values()), flush=True)
    return rows


def main() -> None:
    """Run every column and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plane-only", action="store_true", help="two dimensions alone; nothing is written")
    asked = parser.parse_args()
    rows = [row for ratio in COLUMNS[2] for row in rows_of(2, ratio)]
    if not asked.plane_only:
        rows += [row for ratio in COLUMNS[3] for row in rows_of(3, ratio)]
        write_table(TABLE, Row, rows, digits=4)


if __name__ == "__main__":
    main()
