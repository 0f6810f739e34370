"""What a run on a terrain takes, and what its cells make of the ground: said before it begins."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gns_pl.mpm.settings import solver_config
from gns_pl.scene import Scene
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.selection import Record, kind_of
from gns_pl.solvers.shallow import ShallowSolver
from gns_pl.solvers.solver import Solver
from gns_pl.text import seconds

POINT, LAYER = 24, 32
"""Numbers that MPM keeps of a point, and depth-averaged flow of a cell."""

LARGE_FILE = 1e9
"""From so many bytes on it is said how to keep fewer frames."""


@dataclass(frozen=True)
class Needs:
    """What a run takes.

    Attributes:
        cells: along every axis.
        edge: of a cell [m].
        particles: number of them.
        memory: for cells, particles and the frames that are held [bytes].
        shift: by how much the cells change a height of the ground at most [m].
    """

    cells: tuple[int, ...]
    edge: float
    particles: int
    memory: float
    shift: float


def forecast(solver: Solver, scene: Scene, interval: float, records: Sequence[Record]) -> list[str]:
    """Return sentences about a run on a terrain; none for other scenes, and of other solvers.

    Args:
        solver: that runs it.
        scene: what is run.
        interval: time between frames [s].
        records: runs whose times were measured; on scenes without terrain, and on one machine.
    """
    if scene.terrain is None or not isinstance(solver, MPMSolver | ShallowSolver):
        return []
    frames = round(scene.duration / interval) + 1
    needs = _mpm_needs(solver, scene) if isinstance(solver, MPMSolver) else _shallow_needs(solver, scene, frames)
    written = float(frames) * needs.particles * scene.dim * 4
    time = expected_seconds(solver, scene, records)
    takes = (
        f"{' × '.join(f'{number:,}' for number in needs.cells)} cells of {needs.edge:.3g} m and {needs.particles:,} "
    )
    takes += f"particles: {needs.memory / 1e9:.2g} GB of memory, {written / 1e9:.2g} GB for {frames:,} frames"
    takes += "" if time is None else f", and {seconds(time)} or more: so long without a terrain"
    size = " × ".join(f"{number:,}" for number in scene.terrain.heights.shape)
    ground = f"ground of {size} heights {scene.terrain.cell:.3g} m apart, as it was cropped and resampled; the cells "
    ground += f"change it by up to {needs.shift:.2g} m"
    few = [f"choice.frame_interval={_round_up(interval * written / LARGE_FILE):g} keeps fewer frames"]
    return [takes, ground, *(few if written > LARGE_FILE else [])]


def expected_seconds(solver: Solver, scene: Scene, records: Sequence[Record]) -> float | None:
    """Return the least that a run takes [s], by those of the solver or any plain MPM; None if none was measured."""
    plain = ("mpm_",) if solver.group == "mpm" else ()
    timed = [each for each in records if each.solver == solver.name or each.solver.startswith(plain)]
    rates = [each.seconds / each.work for each in timed if each.kind == kind_of(scene) and each.threads == 1]
    return solver.cost(scene) * statistics.median(rates) if rates else None


def _mpm_needs(solver: MPMSolver, scene: Scene) -> Needs:
    from gns_pl.mpm.ground import column_heights
    from gns_pl.mpm.plan import make_grid, num_surfaces

    assert scene.terrain is not None
    config = solver_config(solver.settings_of(scene))
    grid = make_grid(scene, config.cell_size)
    item = np.dtype(config.precision).itemsize
    points, _ = solver.size(scene)
    nodes = math.prod(grid.nodes) * (8 + 3 + num_surfaces(scene))
    axes = grid.axes[:-1]
    lines = [grid.lower[axis] + grid.cell[axis] * np.arange(grid.nodes[axis]) for axis in axes]
    places = np.stack([place.ravel() for place in np.meshgrid(*lines, indexing="ij")], axis=1)
    heights = column_heights(scene.terrain, grid)[(slice(1, -1),) * len(axes)]
    return Needs(
        cells=tuple(grid.cells[axis] for axis in grid.axes),
        edge=max(grid.cell[axis] for axis in grid.axes),
        particles=points,
        memory=item * float(nodes + POINT * points),
        shift=float(np.abs(heights.ravel() - scene.terrain.height(places)).max()),
    )


def _shallow_needs(solver: ShallowSolver, scene: Scene, frames: int) -> Needs:
    from gns_pl.shallow.config import NUM_PARTICLES
    from gns_pl.shallow.plan import make_grid

    assert scene.terrain is not None
    config = solver.config(scene)
    grid = make_grid(scene, config.cell_size)
    number = config.num_particles or NUM_PARTICLES[scene.dim]
    edges = grid.edges[: scene.dim - 1]
    places = np.stack(grid.centres[: scene.dim - 1], axis=1)
    return Needs(
        cells=grid.shape[: scene.dim - 1],
        edge=max(grid.sizes[: scene.dim - 1]),
        particles=number,
        memory=8.0 * LAYER * math.prod(grid.shape) + 4.0 * frames * number * scene.dim,
        shift=float(np.abs(scene.terrain.means(edges).ravel() - scene.terrain.height(places)).max()),
    )


def _round_up(value: float) -> float:
    """Return the next larger of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(each * power for each in (1, 2, 5, 10) if each * power >= value * (1 - 1e-9))
