"""How a scene will be run: its grid, its time step, and the arrays that the kernels want."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gns_pl
from gns_pl.errors import InputError
from gns_pl.machine import free_memory
from gns_pl.mpm.config import TRANSFERS, MPMConfig
from gns_pl.scene import FACES, Particles, Scene

MIN_STEPS_PER_FRAME = 4
"""With fewer, accelerations taken from frames are rough."""

MAX_SPEED_RATIO = 3.0
"""A point faster than this times `largest_speed` means that the run is unstable: healthy runs stay below 1.4
(collisions pass speed on), unstable ones go beyond 9, mostly without ever becoming infinite."""


NUM_POINT_ARRAYS, ORDER = 7, 10
"""Of a state (`make_state`): how many of its first arrays are about points, and where the order of these stands."""

SAVED = {"position": 0, "velocity": 1, "affine": 2, "stress": 3, "order": ORDER}
"""Name of an array that a run needs to go on → its place in the state; all others follow from scene and settings."""


@dataclass(frozen=True)
class Grid:
    """The grid of a scene; in the plane its y axis has no cells and one layer of nodes.

    Attributes:
        cells: cells per axis (x, y, z).
        nodes: nodes per axis.
        cell: edges of a cell [m]; 1 along the y axis of a plane scene.
        lower: lower corner of the box [m]; 0 along the y axis of a plane scene.
        axes: the scene's axes among x, y, z.
    """

    cells: tuple[int, int, int]
    nodes: tuple[int, int, int]
    cell: tuple[float, float, float]
    lower: tuple[float, float, float]
    axes: tuple[int, ...]


def make_grid(scene: Scene, cell_size: float) -> Grid:
    """Return the grid whose cells come nearest to `cell_size` and divide the box, at least two along each axis.

    Raises:
        InputError: cells larger than the box's shortest edge.
    """
    edges = [high - low for low, high in zip(scene.lower, scene.upper, strict=True)]
    if cell_size > min(edges):
        raise InputError(
            f"mpm: a cell of {cell_size:g} m is larger than the shortest edge of the domain, {min(edges):g} m."
        )
    axes = (0, 2) if scene.dim == 2 else (0, 1, 2)
    cells, cell, lower = [0, 0, 0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]
    for axis, edge, low in zip(axes, edges, scene.lower, strict=True):
        cells[axis] = max(2, round(edge / cell_size))
        cell[axis] = edge / cells[axis]
        lower[axis] = low
    return Grid(
        cells=(cells[0], cells[1], cells[2]),
        nodes=(cells[0] + 1, cells[1] + 1, cells[2] + 1),
        cell=(cell[0], cell[1], cell[2]),
        lower=(lower[0], lower[1], lower[2]),
        axes=axes,
    )


def num_surfaces(scene: Scene) -> int:
    """Return how many rows the table of obstacles has, the ground's among them."""
    return len(scene.obstacles) + (scene.terrain is not None)


def check_grid_memory(scene: Scene, grid: Grid, config: MPMConfig) -> None:
    """Raise an `InputError` where the grid, which spans the whole box, needs more memory than is free."""
    needed = math.prod(grid.nodes) * (8 + 3 + num_surfaces(scene)) * np.dtype(config.precision).itemsize
    free = free_memory()
    if needed > free:
        cells = " x ".join(f"{grid.cells[axis]:,}" for axis in grid.axes)
        raise InputError(
            f"mpm: scene {scene.name!r} has a grid of {cells} cells of {config.cell_size:g} m, which needs "
            f"{needed / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free; take larger cells or a smaller box."
        )


def largest_speed(scene: Scene, particles: Particles) -> float:
    """Return the speed of a free fall from the scene's highest to its lowest place with its initial speed [m/s]."""
    gravity = np.array(scene.gravity)
    lowest = np.maximum(gravity * scene.lower, gravity * scene.upper).sum()  # of −g·x, with its sign turned
    drop = max(float(lowest - (particles.position @ gravity).min()), 0.0)
    initial = float(np.square(particles.velocity).sum(axis=1).max())
    return math.sqrt(initial + 2 * drop)


def num_steps_per_frame(scene: Scene, config: MPMConfig, grid: Grid, speed: float, frame_interval: float) -> int:
    """Return the whole number of steps in a frame, at least `MIN_STEPS_PER_FRAME`.

    The step is the smaller of two: the Courant number asked for, on P-wave plus point speed; and a Courant number of 1
    on the P-wave speed raised by what the bulk viscosity adds to the stiffness of a cell, c (b + √(1 + b²)), a damped
    oscillator's stability limit.
    """
    cell = min(grid.cell[axis] for axis in grid.axes)
    stiffer = config.bulk_viscosity + math.sqrt(1 + config.bulk_viscosity**2)
    step = math.inf
    for body in scene.bodies:
        wave = scene.materials[body.material].p_wave_speed
        limit = max(config.courant, 1.0) * cell / (wave * stiffer + speed)
        step = min(step, config.courant * cell / (wave + speed), limit)
    return max(MIN_STEPS_PER_FRAME, math.ceil(frame_interval / step * (1 - 1e-9)))


@dataclass(frozen=True)
class Plan:
    """How a scene will be run.

    Attributes:
        scene: that is run.
        config: with these settings.
        grid: on this grid.
        speed: largest that is expected [m/s].
        steps: in a frame.
        dt: time step [s].
        num_frames: to keep.
    """

    scene: Scene
    config: MPMConfig
    grid: Grid
    speed: float
    steps: int
    dt: float
    num_frames: int

    @property
    def speed_limit(self) -> float:
        """Speed beyond which a run has failed [m/s]."""
        return MAX_SPEED_RATIO * self.speed + 1e-6

    def place(self, position: NDArray[Any]) -> NDArray[np.float64]:
        """Positions in metres [N, D] of positions in cells [N, 3]."""
        axes = list(self.grid.axes)
        return np.asarray(np.array(self.grid.lower)[axes] + position[:, axes] * np.array(self.grid.cell)[axes])

    def provenance(self, seed: int) -> dict[str, object]:
        """What a trajectory says about its making."""
        return {
            "solver": "gns_pl.mpm",
            "version": gns_pl.__version__,
            "config": asdict(self.config),
            "seed": seed,
            "time_step": self.dt,
            "num_steps": self.steps * (self.num_frames - 1),
            "cell": [self.grid.cell[axis] for axis in self.grid.axes],
        }


def make_plan(scene: Scene, particles: Particles, config: MPMConfig, frame_interval: float) -> Plan:
    """Choose grid and time step of a run.

    Raises:
        InputError: cells that do not fit the box, or that do not resolve the ground, or a grid that does not fit into
            memory.
    """
    from gns_pl.mpm.ground import check_ground

    grid = make_grid(scene, config.cell_size)
    check_grid_memory(scene, grid, config)
    check_ground(scene, grid)
    speed = largest_speed(scene, particles)
    steps = num_steps_per_frame(scene, config, grid, speed, frame_interval)
    num_frames = round(scene.duration / frame_interval) + 1
    return Plan(scene, config, grid, speed, steps, frame_interval / steps, num_frames)


def make_state(scene: Scene, particles: Particles, grid: Grid, config: MPMConfig) -> tuple[NDArray[Any], ...]:
    """Return what changes from step to step, and the points' constants: the first arguments of `grid.advance_steps`."""
    from gns_pl.mpm.constitutive import material_row
    from gns_pl.mpm.grid import BLOCK

    number, axes, num_nodes = len(particles.position), list(grid.axes), math.prod(grid.nodes)
    cell = min(grid.cell[axis] for axis in axes)
    position, velocity = np.zeros((number, 3)), np.zeros((number, 3))
    position[:, axes] = (particles.position - np.array(grid.lower)[axes]) / np.array(grid.cell)[axes]
    velocity[:, axes] = particles.velocity
    materials = [material_row(material, config.bulk_viscosity, cell) for material in scene.materials.values()]
    floating = (
        position,
        velocity,
        np.zeros((number, 9)),  # affine
        np.zeros((number, 7)),  # stress
        particles.mass,
        particles.volume,
    )
    num_blocks = (grid.cells[0] // BLOCK + 1) * (grid.cells[1] // BLOCK + 1)
    real = np.dtype(config.precision)
    return (
        *(array.astype(real) for array in floating),
        particles.material_name,
        np.stack(materials).astype(real),
        np.zeros((num_nodes, 8), dtype=real),  # grid
        np.full((num_nodes, 3 + num_surfaces(scene)), math.inf, dtype=real),  # gap
        np.arange(number, dtype=np.int32),  # order
        np.zeros(number, dtype=np.int32),  # block
        np.zeros(num_blocks + 1, dtype=np.int32),  # start
    )


def make_setting(scene: Scene, grid: Grid, config: MPMConfig, dt: float) -> tuple[Any, ...]:
    """Return what stays the same over all steps: the other arguments of `grid.advance_steps` up to `dt`."""
    from gns_pl.mpm.ground import surface_table
    from gns_pl.mpm.walls import wall_number

    gravity, friction = [0.0, 0.0, 0.0], np.zeros((3, 2))
    faces = FACES[scene.dim]
    for number, axis in enumerate(grid.axes):
        gravity[axis] = scene.gravity[number]
        for side in (0, 1):
            friction[axis, side] = wall_number(scene.walls[faces[2 * number + side]])
    affine_fraction, own = TRANSFERS[config.transfer]
    real = np.dtype(config.precision).type
    return (
        grid.cells,
        grid.nodes,
        tuple(real(1.0 / edge) for edge in grid.cell),
        tuple(real(part) for part in gravity),
        friction.astype(real),
        tuple(real(0.5 * config.spacing / edge) for edge in grid.cell),
        surface_table(scene, grid).astype(real),
        (0,) if scene.dim == 2 else (0, 1, 2),
        real(affine_fraction),
        real(own * config.flip_fraction * math.exp(-config.damping_rate * dt)),
        real(config.local_damping),
        real(dt),
    )
