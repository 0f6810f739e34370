"""Columns and motions with known measures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gns_pl.scene import Material, Scene, Wall, column_collapse, fill_scene
from gns_pl.scene.definition import FACES
from gns_pl.trajectory import Trajectory, start_trajectory

SAND = Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30)
LENGTH, HEIGHT, SPACING, DT = 0.4, 0.2, 0.05, 0.02


def column(dim: int = 3, length: float = LENGTH, height: float = HEIGHT, name: str = "column") -> Scene:
    return column_collapse(
        domain=(1.5, 0.5, 0.7) if dim == 3 else (1.5, 0.7),
        length=length,
        height=height,
        gravity=9.81,
        duration=1.0,
        material=SAND,
        walls={face: Wall("slip") for face in FACES[dim]},
        name=name,
    )


def standing(scene: Scene | None = None, frames: int = 5, spacing: float = SPACING, dt: float = DT) -> Trajectory:
    """A column that does not move."""
    scene = scene or column()
    start = start_trajectory(scene, fill_scene(scene, spacing), dt, {"wall_seconds": 2.0})
    return replace(start, position=np.repeat(start.position, frames, axis=0))


def moved(trajectory: Trajectory, offset: np.ndarray) -> Trajectory:
    """`trajectory` with `offset` [T, D] or [T, N, D] added."""
    offset = np.asarray(offset)
    offset = offset[:, None] if offset.ndim == 2 else offset
    return replace(trajectory, position=(trajectory.position + offset).astype(np.float32))


def spreading(scene: Scene | None = None, frames: int = 30, share: float = 1.0, dt: float = DT) -> Trajectory:
    """A column that is stretched along x and squeezed along z, half as high and twice as long at the end."""
    still = standing(scene, frames, dt=dt)
    stretch = 1 + share * np.sin(np.linspace(0, np.pi / 2, frames))[:, None] ** 2
    position = still.position.astype(np.float64)
    position[:, :, 0] *= stretch
    position[:, :, -1] /= stretch
    return replace(still, position=position.astype(np.float32))
