"""Series of VTK's XML files: a .pvd list of frames with their times, or files whose names end in numbers.

Points are the particles, the same and in the same order in every file. What they carry is taken over where it has the
name of a field of ours: particle_type, mass, tan_friction_angle, and the velocity of the first frame. Files in which
one axis is zero throughout are of two dimensions.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import INITIAL_VELOCITY, MASS, MATERIAL_FEATURES, PARTICLE_TYPE, ParticleType
from gns_pl.io.convert.arrays import split_of
from gns_pl.io.convert.source import (
    ForeignSet,
    Recording,
    Stated,
    checked_material,
    checked_types,
    reading,
    without_material,
)
from gns_pl.io.convert.vtk_xml import parse_xml, read_points

ENDINGS = (".vtp", ".vtu")
_NUMBERED = re.compile(r"(?P<stem>.*?)[_.-]?(?P<number>\d+)")
MOST_LIST_BYTES = 50_000_000


@dataclass(frozen=True)
class Series:
    """The files of a trajectory.

    Attributes:
        name: for messages.
        split: "train", "valid", "test" or "".
        files: one a frame.
        dt: time between frames [s]; None if nothing says.
    """

    name: str
    split: str
    files: tuple[Path, ...]
    dt: float | None


def open_vtk(path: Path, files: Sequence[Path]) -> ForeignSet:
    """Return a set of series.

    Args:
        path: folder or file, as the user named it.
        files: .pvd lists; or, where there is none, the files of frames.

    Raises:
        InputError: lists that cannot be used.
    """
    folder = path if path.is_dir() else path.parent
    lists = [file for file in files if file.suffix == ".pvd"]
    series = [_read_list(file, folder) for file in lists] if lists else _numbered(files, folder)
    intervals = {each.dt for each in series}
    if len(intervals) > 1 and max(filter(None, intervals)) > min(filter(None, intervals)) * (1 + 1e-6):
        raise InputError(f"{path}: its series have different intervals between frames; convert them one by one.")

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(series[number])

    stated = Stated(dt=series[0].dt if series else None)
    return ForeignSet("VTK series", path, tuple((each.split, each.name) for each in series), opener, stated)


def _read_list(file: Path, folder: Path) -> Series:
    with reading(file):
        if file.stat().st_size > MOST_LIST_BYTES:
            raise InputError("is too large for a list of files.")
        frames = []
        for entry in parse_xml(file.read_bytes()).iter("DataSet"):
            name = entry.get("file", "")
            if not name or Path(name).is_absolute() or ".." in Path(name).parts:
                raise InputError(f"lists {name!r}, which is not a file beside or below it.")
            frames.append((float(entry.get("timestep", "nan")), file.parent / name))
        times = np.array([time for time, _ in frames])
        dt = None
        if len(times) > 1 and np.isfinite(times).all():
            steps = np.diff(times)
            dt = float(np.median(steps))
            if not dt > 0 or np.abs(steps - dt).max() > 1e-4 * dt:
                raise InputError("its frames do not follow evenly in time, and a trajectory has one time step.")
            dt = float(f"{(times[-1] - times[0]) / (len(times) - 1):.9g}")
        return Series(file.stem, split_of(file, folder), tuple(path for _, path in frames), dt)


def _numbered(files: Sequence[Path], folder: Path) -> list[Series]:
    found: dict[tuple[Path, str], list[tuple[int, Path]]] = {}
    for file in files:
        match = _NUMBERED.fullmatch(file.stem)
        stem, number = (match["stem"], int(match["number"])) if match else (file.stem, 0)
        found.setdefault((file.parent, stem), []).append((number, file))
    series = []
    for (parent, stem), frames in sorted(found.items()):
        order = tuple(file for _, file in sorted(frames))
        series.append(Series(stem or parent.name, split_of(frames[0][1], folder), order, None))
    return series


@contextmanager
def _open(series: Series) -> Iterator[Recording]:
    points, carried = _points(series.files[0])
    last, _ = _points(series.files[-1])
    axes = [axis for axis in range(3) if points[:, axis].any() or last[:, axis].any()]
    if len(axes) < 2 or len(points) < 2:
        axes = [0, 1, 2]
    number = len(points)

    def read(start: int, stop: int) -> NDArray[Any]:
        frames = []
        for file in series.files[start:stop]:
            frame, _ = _points(file)
            if len(frame) != number:
                raise InputError(f"{file.name} has {len(frame)} particles and the first file {number}; no trajectory.")
            if len(axes) == 2 and frame[:, ({0, 1, 2} - set(axes)).pop()].any():
                raise InputError(f"{file.name} has particles outside the plane of the first frame.")
            frames.append(frame[:, axes])
        return np.stack(frames)

    types = carried.get(PARTICLE_TYPE.name)
    material = carried.get(MATERIAL_FEATURES[0])
    velocity = carried.get("velocity")
    sound = velocity is not None and velocity.shape == points.shape
    mass = carried.get(MASS.name)
    notes = () if types is not None else ("no particle types are stored; all particles are taken for sand, type 6",)
    if sound:
        notes = (*notes, f"{INITIAL_VELOCITY.name} is the velocity of the first frame")
    yield Recording(
        num_frames=len(series.files),
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


def _points(file: Path) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    with reading(file):
        return read_points(file)
