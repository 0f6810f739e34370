"""A trajectory written frame by frame: for runs longer than memory, and for runs that are broken off.

While it grows it stands beside its final name with `GROWING` behind, in HDF5's single-writer mode: whoever reads along,
or finds the file after a `kill -9`, sees whole frames. HDF5 does not open such a file for writing again, so that a run
which goes on copies what is there into a new one. Finished, the file takes its name and is like any other.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import FIELDS, POSITION
from gns_pl.io import schema
from gns_pl.io.atomic import StorageError, atomic_path, free_bytes, sync
from gns_pl.io.hdf5 import (
    GROWING,
    LIBRARY,
    TrajectoryHeader,
    frames_per_chunk,
    open_trajectory,
    read_header,
    read_window,
    write_content,
)
from gns_pl.io.observables import write_observables
from gns_pl.trajectory import Observables, Trajectory

HEADROOM = 2**20
"""Bytes that are left free on the disk, for what HDF5 writes besides frames."""

_SET_ASIDE = f".aside{GROWING}"
_VALUE = schema.LOCATION[POSITION.name]


class TrajectoryStream:
    """A trajectory file to which frames are added.

    Args:
        path: its final name.
        start: everything but the frames, of which none is written.

    Attributes:
        num_frames: how many there are.

    Raises:
        StorageError: the disk refuses.
    """

    def __init__(self, path: str | Path, start: Trajectory) -> None:
        self.path = Path(path)
        self.growing = self.path.with_name(self.path.name + GROWING)
        self.num_frames = 0
        self._waiting: list[NDArray[np.float32]] = []
        self._chunk = frames_per_chunk(start.position.shape[1:])
        with _told(self.growing):
            self._file = h5py.File(self.growing, "w", libver=LIBRARY, locking=False)
            start = replace(start, observables=None)
            empty = replace(start, position=start.position[:0])
            arrays = {field.name: np.asarray(getattr(empty, field.name), dtype=field.dtype) for field in FIELDS}
            write_content(self._file, start, arrays, growing=True)
            self._file.swmr_mode = True

    def append(self, frames: NDArray[np.float32]) -> None:
        """Add frames [n, N, D] [m]; they are in the file once their chunk is full.

        Raises:
            StorageError: the disk refuses; what is in the file stays.
        """
        self.num_frames += len(frames)
        for frame in frames:
            self._waiting.append(frame)
            if len(self._waiting) == self._chunk:
                self._write()

    def flush(self) -> None:
        """Put all frames into the file, whether their chunk is full or not.

        Raises:
            StorageError: the disk refuses; what is in the file stays.
        """
        self._write()

    def _write(self) -> None:
        waiting, self._waiting = self._waiting, []
        if waiting:
            # HDF5 does not survive a full disk, so it is not let near one.
            if free_bytes(self.growing.parent) < sum(frame.nbytes for frame in waiting) + HEADROOM:
                raise StorageError(f"{self.growing}: the disk is full; make room and go on from the frames in it.")
            with _told(self.growing):
                value = self._file[_VALUE]
                length = len(value)
                value.resize(length + len(waiting), axis=0)
                value[length:] = np.stack(waiting)
                value.flush()

    def finish(self, provenance: dict[str, object], observables: Observables | None = None) -> None:
        """Write what is left and how the trajectory was made, and give the file its name.

        Args:
            provenance: how it was made.
            observables: of its frames, where they are to be stored.

        Raises:
            StorageError: the disk refuses; the growing file stays.
        """
        self._write()
        with _told(self.growing):
            self._file.close()
            with h5py.File(self.growing, "r+", libver=LIBRARY, locking=False) as file:
                _replace_provenance(file, provenance)
                if observables is not None:
                    write_observables(file, observables)
            sync(self.growing)
            self.growing.replace(self.path)
            sync(self.path.parent)

    def close(self) -> None:
        """Leave the file growing, with all frames in it; nothing after `finish`."""
        if self._file:
            try:
                self._write()
            finally:
                with _told(self.growing):
                    self._file.close()


def find_frames(path: str | Path) -> tuple[Path, TrajectoryHeader] | None:
    """Return the file that holds most frames of `path` so far, and its header with the number of whole ones.

    Raises:
        InputError: what stands at `path` itself is no trajectory.
    """
    path = Path(path)
    usable: list[tuple[Path, TrajectoryHeader]] = []
    for candidate in (path, path.with_name(path.name + _SET_ASIDE), path.with_name(path.name + GROWING)):
        if candidate.exists():
            # A growing file in which nothing can be read has nothing to lose.
            with nullcontext() if candidate == path else suppress(InputError):
                header = replace(read_header(candidate), num_frames=_whole_frames(candidate))
                usable += [(candidate, header)] if header.num_frames else []
    return max(usable, key=lambda pair: pair[1].num_frames, default=None)


def _whole_frames(path: Path) -> int:
    """Return how many frames can be read; a write that was broken off leaves a wrong checksum at the very end."""
    with open_trajectory(path) as file:
        value = file[_VALUE]
        chunk = value.chunks[0]
        frames = min(len(value), value.id.get_num_chunks() * chunk)
        while frames:
            with suppress(OSError):
                value[frames - 1]
                break
            frames = (frames - 1) // chunk * chunk
    return int(frames)


def go_on(path: str | Path, start: Trajectory, source: Path, num_frames: int) -> TrajectoryStream:
    """Return a stream that holds the first frames of what `find_frames` found.

    Args:
        path: its final name.
        start: everything but the frames.
        source: where they are; kept until all are copied, and beyond that if it is a finished file.
        num_frames: how many to take.

    Raises:
        StorageError: the disk refuses; what was there stays.
    """
    path = Path(path)
    aside = path.with_name(path.name + _SET_ASIDE)
    if source == path.with_name(path.name + GROWING):
        with _told(source):
            source.replace(aside)
        source = aside
    stream = TrajectoryStream(path, start)
    step = frames_per_chunk(start.position.shape[1:])
    for first in range(0, num_frames, step):
        stream.append(read_window(source, first, min(step, num_frames - first)))
    if source == aside:
        aside.unlink()
    return stream


def add_provenance(path: str | Path, facts: Mapping[str, object]) -> None:
    """Add to what a finished file says of how it was made; what it says of the same keys is replaced.

    The file is copied, and the copy takes its name, because HDF5 does not survive being killed while it writes.

    Args:
        path: of a trajectory.
        facts: plain values; where the file says all of them already, nothing is written.

    Raises:
        InputError: no such file, or one that is no trajectory.
        StorageError: the disk refuses; the file is as it was.
    """
    path = Path(path)
    provenance = read_header(path).provenance
    if {**provenance, **facts} == provenance:
        return
    with atomic_path(path) as temporary:
        shutil.copyfile(path, temporary)
        with h5py.File(temporary, "r+", libver=LIBRARY, locking=False) as file:
            _replace_provenance(file, {**provenance, **facts})


def _replace_provenance(file: h5py.File, provenance: Mapping[str, object]) -> None:
    text = json.dumps(provenance, allow_nan=False)
    del file[schema.PROVENANCE]
    file.create_dataset(schema.PROVENANCE, data=text, track_times=False)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn what HDF5 raises where the disk refuses into a `StorageError`."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise StorageError(f"{path}: cannot be written ({str(error).splitlines()[0]}).") from error
