"""One HDF5 file per trajectory: written whole or not at all, read whole, in windows, or only its header."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import gns_pl
from gns_pl.errors import InputError
from gns_pl.fields import FIELDS, OBSERVED, POSITION
from gns_pl.io import schema
from gns_pl.io.atomic import write_atomically
from gns_pl.io.observables import observables_in, write_observables
from gns_pl.io.regular import regular_size
from gns_pl.scene import Scene, scene_from_dict
from gns_pl.trajectory import Observables, Trajectory

CHUNK_BYTES = 64 * 1024
"""Frames share a chunk up to this size. Measured: larger chunks, LZF and gzip make windows slower."""

GROWING = ".growing"
"""Behind the name of a file to which frames are still added (`io.stream`)."""

LIBRARY = ("v110", "v110")  # checksummed metadata, readable by every HDF5 since 1.10


@dataclass(frozen=True)
class TrajectoryHeader:
    """What a file says about itself without its arrays.

    Attributes:
        num_frames: T.
        num_particles: N.
        dim: D.
        dt: time between frames [s].
        material_features: names of the K material features.
        scene: what was simulated.
        provenance: how it was made.
    """

    num_frames: int
    num_particles: int
    dim: int
    dt: float
    material_features: tuple[str, ...]
    scene: Scene
    provenance: dict[str, object]


def write_trajectory(path: str | Path, trajectory: Trajectory) -> None:
    """Write `trajectory` to `path`, whole or not at all, durable when this returns.

    Arrays are stored in the types of `fields.FIELDS`. The file is put together in memory and then written, because
    HDF5 itself does not survive a full disk; this takes as much memory again as the positions.

    Raises:
        InputError: an array holds numbers that are not finite.
        StorageError: the disk refuses; `path` is as it was.
    """
    path = Path(path)
    arrays = {field.name: np.asarray(getattr(trajectory, field.name), dtype=field.dtype) for field in FIELDS}
    _check_finite(path, arrays)
    if trajectory.observables is not None:
        _check_finite(path, {field.name: getattr(trajectory.observables, field.name) for field in OBSERVED})
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=LIBRARY) as file:
        write_content(file, trajectory, arrays)
    write_atomically(path, buffer.getbuffer())


def write_content(
    file: h5py.File, trajectory: Trajectory, arrays: Mapping[str, NDArray[Any]], *, growing: bool = False
) -> None:
    """Write everything a trajectory file holds into an empty, open one.

    Args:
        file: open for writing.
        trajectory: what is not an array.
        arrays: of every field, in its stored type; one without frames still says what a frame is.
        growing: frames can be added to the positions later.
    """
    _write_metadata(file, trajectory)
    for field in FIELDS:
        array = arrays[field.name]
        options: dict[str, Any] = {}
        length = len(array)
        if field is POSITION:
            length = frames_per_chunk(array.shape[1:], array.itemsize)
            length = length if growing else min(length, len(array))
        if array.size or (growing and field is POSITION):
            options = {"chunks": (length, *array.shape[1:]), "fletcher32": True}
        if growing and field is POSITION:
            options["maxshape"] = (None, *array.shape[1:])
        file.create_dataset(schema.LOCATION[field.name], data=array, track_times=False, **options)
    _write_attributes(file, trajectory)
    if trajectory.observables is not None:
        write_observables(file, trajectory.observables)


def frames_per_chunk(shape: tuple[int, ...], itemsize: int = 4) -> int:
    """Return how many frames of a shape share a chunk."""
    return max(1, CHUNK_BYTES // (itemsize * math.prod(shape)))


def _write_metadata(file: Any, trajectory: Trajectory) -> None:
    scene = trajectory.scene
    file.attrs["format"] = schema.FORMAT_NAME
    file.attrs["format_version"] = np.int64(schema.FORMAT_VERSION)
    file.create_group("h5md").attrs["version"] = np.array(schema.H5MD_VERSION, dtype=np.int64)
    file.create_group("h5md/author").attrs["name"] = "unknown"
    file.create_group("h5md/creator").attrs.update({"name": gns_pl.__name__, "version": gns_pl.__version__})
    units = file.create_group("h5md/modules/units")
    units.attrs.update({"version": np.array(schema.UNITS_VERSION, dtype=np.int64), "system": "SI"})
    box = file.create_group(schema.BOX)
    box.attrs.update({"dimension": np.int64(scene.dim), "boundary": ["none"] * scene.dim})
    lower, upper = (np.array(corner, dtype=np.float64) for corner in (scene.lower, scene.upper))
    values = {
        f"{schema.BOX}/edges": upper - lower,
        f"{schema.BOX}/lower": lower,
        schema.STEP: np.int64(1),
        schema.TIME: np.float64(trajectory.dt),
        schema.SCENE: json.dumps(scene.to_dict()),
        schema.PROVENANCE: json.dumps(trajectory.provenance, allow_nan=False),
    }
    for path, value in values.items():
        file.create_dataset(path, data=value, track_times=False)  # file[path] = value would store the time


def _write_attributes(file: Any, trajectory: Trajectory) -> None:
    owner, _, name = schema.FEATURES.partition("@")
    file[owner].attrs.create(name, list(trajectory.material_features), dtype=h5py.string_dtype())
    for entry in schema.ENTRIES:
        if "@" not in entry.path and entry.unit != "1":
            file[entry.path].attrs["unit"] = schema.h5md_unit(entry.unit)


@contextmanager
def open_trajectory(path: str | Path) -> Iterator[Any]:
    """Open a trajectory file for reading and check it; yields an `h5py.File` that `read_window` takes.

    Raises:
        InputError: no such file, truncated, damaged, not a trajectory, or of a newer format; the file is named.
    """
    with _opened(Path(path)) as file:
        with _named(Path(path)):
            schema.check_file(file)
        yield file


def read_header(path: str | Path) -> TrajectoryHeader:
    """Read what a file says about itself.

    Raises:
        InputError: as `open_trajectory`.
    """
    path = Path(path)
    with open_trajectory(path) as file, _named(path):
        return _header(file)


def read_static(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read every array that does not change with time, by field name.

    Raises:
        InputError: as `open_trajectory`.
    """
    path = Path(path)
    with open_trajectory(path) as file, _named(path):
        return {f.name: np.asarray(file[schema.LOCATION[f.name]][()]) for f in FIELDS if "T" not in f.shape}


def read_trajectory(path: str | Path, num_frames: int | None = None, *, observables: bool = False) -> Trajectory:
    """Read a trajectory.

    Args:
        path: its file.
        num_frames: read only the first so many frames; all if None.
        observables: read those of the whole run too, where the file has them (`read_observables`).

    Raises:
        InputError: as `open_trajectory`, or numbers that are not finite.
    """
    path = Path(path)
    with open_trajectory(path) as file, _named(path):
        header = _header(file)
        arrays = {
            f.name: np.asarray(
                file[schema.LOCATION[f.name]][:num_frames] if "T" in f.shape else file[schema.LOCATION[f.name]][()]
            )
            for f in FIELDS
        }
        observed = observables_in(file, num_frames) if observables else None
    _check_finite(path, arrays)
    return Trajectory(
        **arrays,
        material_features=header.material_features,
        dt=header.dt,
        scene=header.scene,
        provenance=header.provenance,
        observables=observed,
    )


def read_observables(path: str | Path) -> Observables | None:
    """Read the observables of the whole run alone, in all frames; None where a file has none.

    Raises:
        InputError: as `open_trajectory`.
    """
    path = Path(path)
    with open_trajectory(path) as file, _named(path):
        return observables_in(file)


def read_window(source: str | Path | h5py.File, start: int, length: int) -> NDArray[np.float32]:
    """Read the positions of `length` frames from frame `start` on.

    Args:
        source: a path, of which only the version is checked; or a file from `open_trajectory`, which saves opening it
            each time (a tenth of a millisecond instead of a half).
        start: first frame.
        length: number of frames.

    Returns:
        [length, N, D] [m].

    Raises:
        InputError: as `open_trajectory`, or a window that reaches outside the trajectory.
    """
    if isinstance(source, str | Path):
        with _opened(Path(source)) as file:
            with _named(Path(source)):
                schema.check_version(file)
            return read_window(file, start, length)
    path = Path(source.filename)
    with _named(path):
        data = source[schema.LOCATION[POSITION.name]]
        if start < 0 or length < 1 or start + length > data.shape[0]:
            raise InputError(f"frames {start} to {start + length - 1} are outside its {data.shape[0]} frames.")
        window: NDArray[np.float32] = np.asarray(data[start : start + length])
    return window


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    with _named(path):
        regular_size(path)
        file = h5py.File(path, "r", locking=False, swmr=path.name.endswith(GROWING))
    with file:
        yield file


def _header(file: Any) -> TrajectoryHeader:
    frames, number, dim = (int(length) for length in file[schema.LOCATION[POSITION.name]].shape)
    owner, _, name = schema.FEATURES.partition("@")
    return TrajectoryHeader(
        num_frames=frames,
        num_particles=number,
        dim=dim,
        dt=float(file[schema.TIME][()]),
        material_features=tuple(str(feature) for feature in file[owner].attrs[name]),
        scene=scene_from_dict(json.loads(file[schema.SCENE].asstr()[()])),
        provenance=dict(json.loads(file[schema.PROVENANCE].asstr()[()])),
    )


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turn every way in which reading HDF5 fails into an `InputError` that names the file."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file.") from error
    except PermissionError as error:
        raise InputError(f"{path}: may not be read.") from error
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        what = "is truncated or damaged" if path.is_file() and h5py.is_hdf5(path) else "is not an HDF5 file"
        raise InputError(f"{path}: {what}.") from error


def _check_finite(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            when = f" from frame {int(np.argmin(np.isfinite(array).all(axis=(1, 2))))} on" if name == "position" else ""
            raise InputError(f"{path}: {name} holds numbers that are not finite{when}.")
