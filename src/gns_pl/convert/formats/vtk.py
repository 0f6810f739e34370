"""Series of VTK's XML files: a .pvd list of frames with their times, or files whose names end in numbers.

Points are the particles: in the same order in every file, or told apart by an array `id`. What they carry is taken
over where it has the name of a field of ours: particle_type, mass, tan_friction_angle, and the velocity of the first
frame. Files in which one axis is zero throughout are of two dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.deck import read_deck
from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.source import (
    ForeignSet,
    Recording,
    Stated,
    checked_material,
    checked_types,
    reading,
    without_material,
)
from gns_pl.convert.formats.vtk_series import Series, find_series, read_frame
from gns_pl.errors import InputError
from gns_pl.fields import INITIAL_VELOCITY, MASS, MATERIAL_FEATURES, PARTICLE_TYPE, ParticleType

ENDINGS = (".vtp", ".vtu")
IDS = ("id", "ids", "particle_id", "GlobalPointIds")
DISPLACEMENTS = ("displacements", "displacement")
"""What tells particles apart where several ranks write them, best first."""

PointArrays = dict[str, NDArray[Any]]
Order = Callable[[NDArray[Any], PointArrays], NDArray[np.int64]]
"""Points of a frame and what they carry → [N] place in the frame of each particle."""


def open_vtk(path: Path, files: Sequence[Path], *, deck: Path | None = None) -> ForeignSet:
    """Return a set of series.

    Args:
        path: folder or file, as the user named it.
        files: .pvd lists; or, where there is none, the files of frames.
        deck: JSON input of CB-Geo MPM, where it wrote the series: numbers are then its solver steps.

    Raises:
        InputError: lists or a deck that cannot be used, or frames that are missing.
    """
    series, notes = find_series(files, path if path.is_dir() else path.parent)
    kind, stated = "VTK series", Stated(dt=next((each.dt for each in series if each.dt is not None), None))
    if deck is not None:
        step = next((each.numbers[1] - each.numbers[0] for each in series if len(each.numbers) > 1), None)
        by_deck = read_deck(deck).stated(step, series[0].numbers[0])
        kind, stated = "CB-Geo MPM", by_deck if stated.dt is None else replace(by_deck, dt=stated.dt)

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(series[number], stated.friction_angle_deg)

    names = tuple((each.split, each.name) for each in series)
    stated = replace(stated, notes=(*notes, *stated.notes))
    return ForeignSet(kind, path, names, opener, stated, si=deck is not None)


@contextmanager
def _open(series: Series, friction_angle_deg: float | None) -> Iterator[Recording]:
    points, arrays = read_frame(series, series.numbers[0])
    order = _order_of(series, points, arrays)
    if order is not None:
        place = order(points, arrays)
        points, arrays = points[place], {name: values[place] for name, values in arrays.items()}
    last, _ = read_frame(series, series.numbers[-1], attributes=False)
    axes = [axis for axis in range(3) if points[:, axis].any() or last[:, axis].any()]
    if len(axes) < 2 or len(points) < 2:
        axes = [0, 1, 2]
    number = len(points)

    def read(start: int, stop: int) -> NDArray[Any]:
        frames = []
        for frame in series.numbers[start:stop]:
            name = series.frames[frame][0].name
            where, more = read_frame(series, frame, attributes=order is not None)
            if len(where) != number:
                raise InputError(f"{name} has {len(where)} particles and the first file {number}; no trajectory.")
            if order is not None:
                with reading(series.frames[frame][0]):
                    where = where[order(where, more)]
            if len(axes) == 2 and where[:, ({0, 1, 2} - set(axes)).pop()].any():
                raise InputError(f"{name} has particles outside the plane of the first frame.")
            frames.append(where[:, axes])
        return np.stack(frames)

    types = arrays.get(PARTICLE_TYPE.name)
    tangent = None if friction_angle_deg is None else np.array(np.tan(np.radians(friction_angle_deg)))
    material = arrays.get(MATERIAL_FEATURES[0], tangent)
    velocity = arrays.get("velocity", arrays.get("velocities") if series.numbers[0] == 0 else None)
    sound = velocity is not None and velocity.shape == points.shape
    mass = arrays.get(MASS.name)
    notes = () if types is not None else ("no particle types are stored; all particles are taken for sand, type 6",)
    if sound:
        notes = (*notes, f"{INITIAL_VELOCITY.name} is the velocity of the first frame")
    yield Recording(
        num_frames=len(series.numbers),
        particle_type=checked_types(np.array(int(ParticleType.SAND)) if types is None else types, number),
        read=read,
        dim=len(axes),
        material=without_material(number) if material is None else checked_material(material, number),
        material_features=() if material is None else MATERIAL_FEATURES[:1],
        initial_velocity=np.asarray(velocity, dtype=np.float64)[:, axes] if sound else None,
        mass=None if mass is None or mass.shape != (number,) else mass.astype(np.float64),
        dtype=str(points.dtype),
        notes=notes,
    )


def _order_of(series: Series, points: NDArray[Any], arrays: PointArrays) -> Order | None:
    """Return how particles are found again: by their ids or by where they came from; None: by their place in the file.

    Raises:
        InputError: a frame is in several files, between which particles move, and nothing tells them apart.
    """
    for name in IDS:
        ids = arrays.get(name)
        if ids is not None and ids.shape == (len(points),) and len(np.unique(ids)) == len(ids):
            return _by_ids(name, np.sort(ids))
    if not series.in_parts:
        return None
    for name in DISPLACEMENTS:
        if name in arrays and arrays[name].shape == points.shape:
            return _by_origin(name, points - arrays[name])
    raise InputError(
        "has its frames in several files, between which particles may move, and nothing tells them apart (id, or "
        "displacements); write one file a frame, or convert the particles….h5 of the run."
    )


def _by_ids(name: str, ids: NDArray[Any]) -> Order:
    def order(where: NDArray[Any], more: PointArrays) -> NDArray[np.int64]:
        place = np.argsort(more[name], kind="stable") if name in more else np.arange(0)
        if not len(place) or not np.array_equal(more[name][place], ids):
            raise InputError(f"has other particles, by their {name}, than the first file.")
        return place

    return order


def _by_origin(name: str, origins: NDArray[Any]) -> Order:
    """Return an order by points less displacements, which are the same in all frames but for rounding."""
    from scipy.spatial import cKDTree

    tree = cKDTree(origins)
    reach = tree.query(origins, k=2)[0][:, 1].min() / 4 if len(origins) > 1 else np.inf

    def order(where: NDArray[Any], more: PointArrays) -> NDArray[np.int64]:
        if name not in more:
            raise InputError(f"lacks {name}, by which particles are found again.")
        distance, particle = tree.query(where - more[name])
        if not (distance < reach).all() or len(np.unique(particle)) != len(origins):
            raise InputError(f"has {name} that do not lead back to the places of the first file's particles.")
        return np.argsort(particle)

    return order


def _open_source(source: Source) -> ForeignSet | None:
    files = source.files
    frames = files.get(".pvd") or sorted(file for ending in ENDINGS for file in files.get(ending, []))
    if not frames or files.get(".tfrecord"):  # a series beside a set shows it
        return None
    return open_vtk(source.path, frames, deck=source.deck)


FORMAT = Format("VTK (.pvd, .vtp, .vtu)", (".pvd", *ENDINGS), _open_source, takes_deck=True)
