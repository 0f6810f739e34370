"""`simulate`: fill a scene, choose grid and time step, run, and keep the frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gns_pl
from gns_pl.errors import InputError
from gns_pl.mpm.config import MPMConfig, SimulationError
from gns_pl.scene import FACES, Particles, Scene, fill_scene
from gns_pl.trajectory import Trajectory, start_trajectory

MIN_STEPS_PER_FRAME = 4
"""With fewer, accelerations taken from frames are rough."""

MAX_SPEED_RATIO = 3.0
"""A point faster than this times `largest_speed` means that the run is unstable: healthy runs stay below 1.4
(collisions pass speed on), unstable ones go beyond 9, mostly without ever becoming infinite."""


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
    on the P-wave speed raised by what the bulk viscosity adds to the stiffness of a cell, c (ξ + √(1 + ξ²)) with
    ξ = τ c K / (M h), a damped oscillator's stability limit. The second one acts on fine grids only.
    """
    cell = min(grid.cell[axis] for axis in grid.axes)
    step = math.inf
    for body in scene.bodies:
        material = scene.materials[body.material]
        wave = material.p_wave_speed
        ratio = (1 + material.poisson_ratio) / (3 * (1 - material.poisson_ratio))  # K / M
        xi = config.viscosity_time * wave * ratio / cell
        limit = max(config.courant, 1.0) * cell / (wave * (xi + math.sqrt(1 + xi * xi)) + speed)
        step = min(step, config.courant * cell / (wave + speed), limit)
    return max(MIN_STEPS_PER_FRAME, math.ceil(frame_interval / step * (1 - 1e-9)))


def make_state(scene: Scene, particles: Particles, grid: Grid, config: MPMConfig) -> tuple[NDArray[Any], ...]:
    """Return what changes from step to step, and the points' constants: the first ten arguments of `grid.advance`."""
    from gns_pl.mpm.constitutive import material_row

    number, axes, num_nodes = len(particles.position), list(grid.axes), math.prod(grid.nodes)
    position, velocity = np.zeros((number, 3)), np.zeros((number, 3))
    position[:, axes] = (particles.position - np.array(grid.lower)[axes]) / np.array(grid.cell)[axes]
    velocity[:, axes] = particles.velocity
    return (
        position,
        velocity,
        np.zeros((number, 9)),  # affine
        np.zeros((number, 7)),  # stress
        particles.mass,
        particles.volume,
        particles.material_name,
        np.stack([material_row(material, config.viscosity_time) for material in scene.materials.values()]),
        np.zeros((num_nodes, 8)),  # grid
        np.full((num_nodes, 3), math.inf),  # gap
    )


def make_setting(scene: Scene, grid: Grid, config: MPMConfig, dt: float) -> tuple[Any, ...]:
    """Return what stays the same over all steps: the other arguments of `grid.advance` up to `dt`."""
    from gns_pl.mpm.walls import STICK

    gravity, friction = [0.0, 0.0, 0.0], np.zeros((3, 2))
    faces = FACES[scene.dim]
    for number, axis in enumerate(grid.axes):
        gravity[axis] = scene.gravity[number]
        for side in (0, 1):
            wall = scene.walls[faces[2 * number + side]]
            friction[axis, side] = STICK if wall.condition == "stick" else wall.friction
    return (
        grid.cells,
        grid.nodes,
        tuple(1.0 / edge for edge in grid.cell),
        tuple(gravity),
        friction,
        tuple(0.5 * config.spacing / edge for edge in grid.cell),
        (0,) if scene.dim == 2 else (0, 1, 2),
        0.0 if config.transfer == "pic" else 1.0,
        math.exp(-config.damping_rate * dt) if config.transfer == "flip" else 0.0,
        dt,
    )


def simulate(
    scene: Scene,
    config: MPMConfig,
    *,
    frame_interval: float,
    seed: int = 0,
    on_frame: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Run `scene` from its start over its duration.

    One thread; the kernels release the GIL. The same arguments give the same bits on the same machine.

    Args:
        scene: what to simulate, in two or three dimensions.
        config: how.
        frame_interval: time between the frames kept [s].
        seed: of the generator that draws the jitter of the points.
        on_frame: called after every frame with its index (from 0) and the number of frames.

    Returns:
        round(duration / frame_interval) + 1 frames.

    Raises:
        InputError: a frame interval that is not positive, or cells that do not fit the box.
        SimulationError: velocities that are not finite or far above what the scene's energy allows.
    """
    from gns_pl.mpm.grid import advance  # here, so that importing the room stays light

    if not (math.isfinite(frame_interval) and frame_interval > 0):
        raise InputError(f"mpm: frame_interval must be a positive number, not {frame_interval}.")
    grid = make_grid(scene, config.cell_size)
    particles = fill_scene(scene, config.spacing, jitter=config.jitter, generator=np.random.default_rng(seed))
    speed = largest_speed(scene, particles)
    steps = num_steps_per_frame(scene, config, grid, speed, frame_interval)
    dt = frame_interval / steps
    num_frames = round(scene.duration / frame_interval) + 1

    state = make_state(scene, particles, grid, config)
    setting = make_setting(scene, grid, config, dt)
    position, velocity = state[:2]
    axes = list(grid.axes)
    cell, lower = np.array(grid.cell)[axes], np.array(grid.lower)[axes]
    frames = np.empty((num_frames, len(position), scene.dim), dtype=np.float32)
    put_back = 0
    for frame in range(num_frames):
        if frame > 0:
            put_back += advance(*state, *setting, steps)
            fastest = math.sqrt(np.square(velocity).sum(axis=1).max())
            if not fastest <= MAX_SPEED_RATIO * speed + 1e-6:  # NaN comes here too
                raise SimulationError(
                    f"scene {scene.name!r}: the simulation is unstable at {frame * frame_interval:.6g} s, with a speed "
                    f"of {fastest:.3g} m/s where about {speed:.3g} m/s can be reached (courant {config.courant:g}, "
                    f"time step {dt:.3g} s); choose a smaller courant."
                )
        frames[frame] = lower + position[:, axes] * cell
        if on_frame is not None:
            on_frame(frame, num_frames)
    provenance: dict[str, object] = {
        "solver": "gns_pl.mpm",
        "version": gns_pl.__version__,
        "config": asdict(config),
        "seed": seed,
        "time_step": dt,
        "num_steps": steps * (num_frames - 1),
        "cell": [grid.cell[axis] for axis in axes],
        "num_put_back": int(put_back),
    }
    return replace(start_trajectory(scene, particles, frame_interval, provenance), position=frames)
