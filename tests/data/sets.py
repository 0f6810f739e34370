"""Data sets of made-up motion whose truth is known: written as files with a manifest, without any solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gns_pl.data.statistics import RunningStatistics
from gns_pl.io import FileRecord, Manifest, file_sha256, read_manifest, write_manifest, write_trajectory
from gns_pl.io.manifest import MANIFEST_VERSION
from gns_pl.scene import Body, Scene, Wall
from gns_pl.scene.definition import FACES
from gns_pl.trajectory import Trajectory
from tests.conftest import SAND, make_start

SPACING, DT = 0.05, 0.01


def make_scene(
    *,
    position: Sequence[float] = (0.3, 0.3, 0.6),
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    size: Sequence[float] = (0.3, 0.3, 0.3),
) -> Scene:
    """A 1 m box with one body in it."""
    walls = {face: Wall("friction", 0.385) for face in FACES[3]}
    body = Body(tuple(position), tuple(size), tuple(velocity))
    return Scene("made_up", (0.0,) * 3, (1.0,) * 3, (0.0, 0.0, -9.81), 0.3, {"sand": SAND}, (body,), walls)


def make_flight(scene: Scene, frames: int) -> Trajectory:
    """Free fall: x0 + v0 t + g t² / 2 exactly, walls or not."""
    return moved(scene, lambda t: scene_velocity(scene) * t + 0.5 * np.array(scene.gravity) * t**2, frames)


def scene_velocity(scene: Scene) -> NDArray[np.float64]:
    return np.array(scene.bodies[0].velocity)


def moved(scene: Scene, path: object, frames: int) -> Trajectory:
    """The body of a scene displaced by `path(t)`, [D] or [N, D] [m]."""
    start = make_start(scene, SPACING, DT)
    first = start.position[0].astype(np.float64)
    position = np.stack([first + path(DT * frame) for frame in range(frames)])  # type: ignore[operator]
    return replace(start, position=position.astype(np.float32))


def write_set(
    folder: Path, trajectories: Sequence[Trajectory], *, valid: int = 1, scale: float = 1.0, dt_factor: float = 1.0
) -> Manifest:
    """Write a data set, the last `valid` held out.

    `scale` multiplies the positions and `dt_factor` the stated time step, as a faulty export would; scenes, initial
    velocities and the spacing stay what they are.
    """
    folder.mkdir(parents=True, exist_ok=True)
    statistics = {"velocity": RunningStatistics(3), "acceleration": RunningStatistics(3)}
    files = {}
    for index, sound in enumerate(trajectories):
        trajectory = replace(sound, position=scale * sound.position, dt=dt_factor * sound.dt)
        name = f"trajectory_{index:04d}.h5"
        write_trajectory(folder / name, trajectory)
        files[name] = FileRecord(file_sha256(folder / name), trajectory.num_frames, trajectory.num_particles)
        statistics["velocity"].update(trajectory.velocity().reshape(-1, 3))
        statistics["acceleration"].update(trajectory.acceleration().reshape(-1, 3))
    names = tuple(files)
    cut = len(names) - valid
    write_manifest(
        folder,
        Manifest(
            format_version=MANIFEST_VERSION,
            name="made_up",
            dt=dt_factor * trajectories[0].dt,
            dim=3,
            spacing=SPACING,
            particle_types=(6,),
            material_features=trajectories[0].material_features,
            splits={"train": names[:cut], "valid": names[cut:], "test": ()},
            files=files,
            statistics={quantity: seen.to_dict() for quantity, seen in statistics.items()},
            seed=0,
            spec={"name": "made_up"},
        ),
    )
    return read_manifest(folder)
