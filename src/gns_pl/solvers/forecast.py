"""What a run on a terrain takes, and what its cells make of the ground: said before it begins."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gns_pl.mpm.settings import solver_config
from gns_pl.scene import Scene
from gns_pl.scene.extent import num_frames
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.shallow import ShallowSolver
from gns_pl.solvers.solver import Solver
from gns_pl.text import seconds

if TYPE_CHECKING:
    from gns_pl.mpm.plan import Grid

POINT, LAYER = 24, 32
"""Numbers that MPM keeps of a point, and depth-averaged flow of a cell."""

POINT_STEP, NODE_STEP, CELL_STEP, FRAME, BYTE = 3.4e-7, 5e-9, 3.3e-7, 1e-7, 2.5e-9
"""Processor time of a step of MPM for every point and every node that is stepped, of a step of depth-averaged flow for
every cell, of a frame for every particle, and of a byte of memory that is taken at the start [s]: on the machine and of
the runs of `benchmarks/forecast.py`."""

START = 0.5
"""Time before the first step, in which compiled code is loaded and particles are placed [s]."""

LARGE_FILE = 1e9
"""From so many bytes on it is said how to keep fewer frames."""


@dataclass(frozen=True)
class Needs:
    """What a run takes.

    Attributes:
        cells: along every axis.
        edge: of a cell [m].
        particles: number of them.
        memory: for cells, particles and the frames that are held, at most [bytes].
        start_memory: of it, what the start needs; MPM takes the rest as the flow spreads over its grid [bytes].
        seconds: processor time of the run, about [s].
        shift: by how much the cells change a height of the ground at most [m].
    """

    cells: tuple[int, ...]
    edge: float
    particles: int
    memory: float
    start_memory: float
    seconds: float
    shift: float


def forecast(solver: Solver, scene: Scene, interval: float) -> list[str]:
    """Return sentences about a run on a terrain; none for other scenes, and of other solvers.

    Args:
        solver: that runs it.
        scene: what is run.
        interval: time between frames [s].
    """
    needs = needs_of(solver, scene, interval)
    if needs is None or scene.terrain is None:
        return []
    frames = num_frames(scene, interval)
    written = float(frames) * needs.particles * scene.dim * 4
    cells = " × ".join(f"{number:,}" for number in needs.cells)
    memory = " to ".join(dict.fromkeys(f"{most / 1e9:.2g}" for most in (needs.start_memory, needs.memory)))
    takes = f"{cells} cells of {needs.edge:.3g} m and {needs.particles:,} particles: {memory} GB of "
    takes += f"memory, {written / 1e9:.2g} GB for {frames:,} frames, and about {seconds(needs.seconds)} on one core"
    size = " × ".join(f"{number:,}" for number in scene.terrain.heights.shape)
    ground = f"ground of {size} heights {scene.terrain.cell:.3g} m apart, as it was cropped and resampled; the cells "
    ground += f"change it by up to {needs.shift:.2g} m"
    few = [f"choice.frame_interval={_round_up(interval * written / LARGE_FILE):g} keeps fewer frames"]
    return [takes, ground, *(few if written > LARGE_FILE else [])]


def needs_of(solver: Solver, scene: Scene, interval: float) -> Needs | None:
    """Return what a run on a terrain takes, None of other scenes and solvers; arguments as those of `forecast`."""
    if scene.terrain is None:
        return None
    frames = num_frames(scene, interval)
    if isinstance(solver, MPMSolver):
        return _mpm_needs(solver, scene, frames)
    return _shallow_needs(solver, scene, frames) if isinstance(solver, ShallowSolver) else None


def _mpm_needs(solver: MPMSolver, scene: Scene, frames: int) -> Needs:
    from gns_pl.mpm.ground import column_heights
    from gns_pl.mpm.plan import MIN_STEPS_PER_FRAME, make_grid, num_surfaces

    assert scene.terrain is not None
    config = solver_config(solver.settings_of(scene))
    grid = make_grid(scene, config.cell_size)
    item = np.dtype(config.precision).itemsize
    points, steps = solver.size(scene)
    steps = (frames - 1) * max(MIN_STEPS_PER_FRAME, math.ceil(steps / (frames - 1)))
    nodes, start = math.prod(grid.nodes), _start_nodes(scene, grid)
    # Only nodes in the box around all points are stepped. It grows, from that of the bodies, to nobody knows where.
    stepped = math.sqrt(start * nodes)
    memory = item * float(start * 8 + nodes * (3 + num_surfaces(scene)) + POINT * points)
    axes = grid.axes[:-1]
    lines = [grid.lower[axis] + grid.cell[axis] * np.arange(grid.nodes[axis]) for axis in axes]
    places = np.stack([place.ravel() for place in np.meshgrid(*lines, indexing="ij")], axis=1)
    heights = column_heights(scene.terrain, grid)[(slice(1, -1),) * len(axes)]
    return Needs(
        cells=tuple(grid.cells[axis] for axis in grid.axes),
        edge=max(grid.cell[axis] for axis in grid.axes),
        particles=points,
        memory=item * float(nodes * (8 + 3 + num_surfaces(scene)) + POINT * points),
        start_memory=memory,
        seconds=START + BYTE * memory + steps * (POINT_STEP * points + NODE_STEP * stepped) + frames * FRAME * points,
        shift=float(np.abs(heights.ravel() - scene.terrain.height(places)).max()),
    )


def _start_nodes(scene: Scene, grid: Grid) -> float:
    """Return the number of nodes of MPM's grid in the box around all bodies."""
    lower = [min(body.position[axis] for body in scene.bodies) for axis in range(scene.dim)]
    upper = [max(body.upper[axis] for body in scene.bodies) for axis in range(scene.dim)]
    edges = [grid.cell[axis] for axis in grid.axes]
    return math.prod((high - low) / edge + 3 for low, high, edge in zip(lower, upper, edges, strict=True))


def _shallow_needs(solver: ShallowSolver, scene: Scene, frames: int) -> Needs:
    from gns_pl.shallow.config import NUM_PARTICLES
    from gns_pl.shallow.plan import make_grid

    assert scene.terrain is not None
    config = solver.config(scene)
    grid = make_grid(scene, config.cell_size)
    number = config.num_particles or NUM_PARTICLES[scene.dim]
    edges, cells = grid.edges[: scene.dim - 1], math.prod(grid.shape)
    steps = max(frames - 1, solver.cost(scene) / cells)
    places = np.stack(grid.centres[: scene.dim - 1], axis=1)
    memory = 8.0 * LAYER * cells + 4.0 * frames * number * scene.dim
    return Needs(
        cells=grid.shape[: scene.dim - 1],
        edge=max(grid.sizes[: scene.dim - 1]),
        particles=number,
        memory=memory,
        start_memory=memory,
        seconds=START + steps * CELL_STEP * cells + frames * FRAME * number,
        shift=float(np.abs(scene.terrain.means(edges).ravel() - scene.terrain.height(places)).max()),
    )


def _round_up(value: float) -> float:
    """Return the next larger of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(each * power for each in (1, 2, 5, 10) if each * power >= value * (1 - 1e-9))
