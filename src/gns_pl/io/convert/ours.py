"""Our own data sets and single trajectories, as a source for the others' formats."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np

from gns_pl.errors import InputError
from gns_pl.io import open_trajectory, read_header, read_manifest, read_static, read_window
from gns_pl.io.convert.source import ForeignSet, Recording, Stated


def open_ours(path: Path) -> ForeignSet:
    """Return a data set's folder, or a single trajectory file.

    Raises:
        InputError: a manifest or a file that cannot be used.
    """
    if path.is_dir():
        manifest = read_manifest(path)
        names = [(split, name) for split, files in manifest.splits.items() for name in files]
        folder, spacing = path, manifest.spacing
    else:
        names, folder, spacing = [("", path.name)], path.parent, None
    if not names:
        raise InputError(f"{path}: its manifest lists no trajectory.")
    header = read_header(folder / names[0][1])
    scene = header.scene
    material = scene.materials[scene.bodies[0].material]
    stated = Stated(
        dt=header.dt,
        lower=scene.lower,
        upper=scene.upper,
        gravity=scene.gravity,
        spacing=spacing,
        density=material.density,
        friction_angle_deg=material.friction_angle_deg,
    )

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(folder / names[number][1])

    return ForeignSet("gns_pl", path, tuple(names), opener, stated)


@contextmanager
def _open(path: Path) -> Iterator[Recording]:
    header, static = read_header(path), read_static(path)
    with open_trajectory(path) as file:
        yield Recording(
            num_frames=header.num_frames,
            particle_type=static["particle_type"],
            read=lambda start, stop: read_window(file, start, stop - start),
            dim=header.dim,
            material=static["material"],
            material_features=header.material_features,
            initial_velocity=static["initial_velocity"].astype(np.float64),
            mass=static["mass"].astype(np.float64),
            origin=header.scene.origin,
        )
