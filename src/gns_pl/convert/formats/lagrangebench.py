"""LagrangeBench: train.h5, valid.h5, test.h5 with groups 00000, 00001, … of position and particle_type; metadata.json.

Its types are fluid 0, solid wall 1, moving wall 2 and rigid body 3; here walls are kinematic (3), fluid is 5 and rigid
bodies are 1, as in DeepMind's sets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.groups import group_names, open_group
from gns_pl.convert.formats.metadata import read_stated
from gns_pl.convert.formats.source import ForeignSet, Recording, reading
from gns_pl.fields import ParticleType
from gns_pl.io import SPLITS

POSITION = "position"
TYPES = {0: 5, 1: int(ParticleType.KINEMATIC), 2: int(ParticleType.KINEMATIC), 3: 1}
"""LagrangeBench's particle types → those here."""
THEIRS = {int(ParticleType.KINEMATIC): 1, 1: 3}
"""And back; every other type is fluid."""


def open_lagrangebench(path: Path, files: Sequence[Path]) -> ForeignSet:
    """Return a set of .h5 files.

    Args:
        path: folder or file, as the user named it.
        files: of it, each a split by its name.

    Raises:
        InputError: a file that cannot be used.
    """
    names: list[tuple[str, str]] = []
    places: list[tuple[Path, str]] = []
    for file in files:
        with reading(file):
            found = group_names(file, POSITION)
        names += [(file.stem if file.stem in SPLITS else "", f"{file.name}/{name}") for name in found]
        places += [(file, name) for name in found]
    folder = path if path.is_dir() else path.parent
    stated, of_split = read_stated(folder, {split for split, _ in names})
    notes = (*stated.notes, "walls, types 1 and 2 of LagrangeBench, are kinematic particles, fluid is type 5")

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _translated(*places[number])

    return ForeignSet("LagrangeBench", path, tuple(names), opener, replace(stated, notes=notes), of_split)


@contextmanager
def _translated(file: Path, name: str) -> Iterator[Recording]:
    with open_group(file, name, position=POSITION, material=None) as recording:
        types = recording.particle_type
        yield replace(recording, particle_type=translate_types(types, TYPES))


def translate_types(types: NDArray[np.int64], table: Mapping[int, int]) -> NDArray[np.int64]:
    """Return particle types by a table; those that it lacks stay as they are [N]."""
    return np.array([table.get(int(each), int(each)) for each in types], dtype=np.int64)


@contextmanager
def groups_writer(path: Path) -> Iterator[Callable[[int, int, NDArray[np.int64], Iterator[NDArray[Any]]], None]]:
    """Write an .h5 file trajectory by trajectory, block by block.

    Args:
        path: of the file, made here.

    Yields:
        A function to call with the number of the trajectory, T, particle types [N] and blocks of positions [n, N, D].
    """
    with h5py.File(path, "w", locking=False) as file:

        def add(number: int, frames: int, types: NDArray[np.int64], blocks: Iterator[NDArray[Any]]) -> None:
            group = file.create_group(f"{number:05d}")
            fluid = [THEIRS.get(int(each), 0) for each in types]
            group.create_dataset("particle_type", data=np.array(fluid, dtype=np.int32), track_times=False)
            data, start = None, 0
            for block in blocks:
                if data is None:
                    shape = (frames, *block.shape[1:])
                    data = group.create_dataset(POSITION, shape, dtype=np.float32, track_times=False)
                data[start : start + len(block)] = block
                start += len(block)

        yield add


def _open_source(source: Source) -> ForeignSet | None:
    files = source.files.get(".h5", [])
    if not files:
        return None
    with reading(files[0]):
        return open_lagrangebench(source.path, files) if group_names(files[0], POSITION) else None


FORMAT = Format("LagrangeBench (.h5)", (".h5",), _open_source)
