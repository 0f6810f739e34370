"""Our own data sets and single trajectories, as a source for the others' formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np

from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.groups import open_hdf5
from gns_pl.convert.formats.source import ForeignSet, Recording, Stated, reading
from gns_pl.errors import InputError
from gns_pl.io import (
    MANIFEST_NAME,
    TrajectoryHeader,
    open_trajectory,
    read_header,
    read_manifest,
    read_static,
    read_window,
)
from gns_pl.io.schema import FORMAT_NAME

KIND = "gns_pl"


def open_ours(path: Path) -> ForeignSet:
    """Return a data set's folder, or a single trajectory file.

    Raises:
        InputError: a manifest or a file that cannot be used.
    """
    spacing: float | None
    if path.is_dir():
        manifest = read_manifest(path)
        names = [(split, name) for split, files in manifest.splits.items() for name in files]
        folder, spacing, content = path, manifest.spacing, dataclasses.asdict(manifest)
        if not names:
            raise InputError(f"{path}: its manifest lists no trajectory.")
    else:
        scene = read_header(path).scene.to_dict()
        spec = {"material": scene["materials"][scene["bodies"][0]["material"]], "walls": scene["walls"]}
        names, folder, content = [("", path.name)], path.parent, {"spec": spec, "seed": 0}
        spacing = _spacing(path)
    radius = content["spec"].get("imported", {}).get("connectivity_radius")
    first = _stated(read_header(folder / names[0][1]))
    stated = dataclasses.replace(first, spacing=spacing, radius=radius, metadata=content)

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(folder / names[number][1])

    return ForeignSet(KIND, path, tuple(names), opener, stated, si=True)


def _stated(header: TrajectoryHeader) -> Stated:
    scene = header.scene
    material = scene.materials[scene.bodies[0].material]
    return Stated(
        dt=header.dt,
        lower=scene.lower,
        upper=scene.upper,
        gravity=scene.gravity,
        origin=scene.origin,
        density=material.density,
        friction_angle_deg=material.friction_angle_deg,
    )


def _spacing(path: Path) -> float | None:
    """Return (V / N)^(1/D) [m] of a trajectory by its masses; None if its materials differ in density."""
    header, mass = read_header(path), read_static(path)["mass"]
    densities = {header.scene.materials[body.material].density for body in header.scene.bodies}
    if len(densities) > 1:
        return None
    return float((mass.mean(dtype=np.float64) / densities.pop()) ** (1 / header.dim))


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
            stated=_stated(header),
            scene=header.scene,
            provenance=header.provenance,
        )


def _open_source(source: Source) -> ForeignSet | None:
    path = source.path
    if path.is_dir() and (path / MANIFEST_NAME).is_file():
        return open_ours(path)
    first = next(iter(source.files.get(".h5", ())), None)
    if first is None:
        return None
    with reading(first):
        with open_hdf5(first) as file:
            if file.attrs.get("format") != FORMAT_NAME:
                return None
        if path.is_file():
            return open_ours(path)
        stored = sorted(each.parent for each in path.glob(f"*/{MANIFEST_NAME}"))
        if stored:
            raise InputError(f"is of a data set of gns_pl, of which {path} has {len(stored)}; name one: {stored[0]}")
        raise InputError(f"is a trajectory of gns_pl, but {path} has no {MANIFEST_NAME}; name the files one by one.")


FORMAT = Format("gns_pl's own (.h5)", (".h5",), _open_source)
