"""Plain arrays: .npy files of positions [T, N, D], and .npz files of named arrays. Nothing pickled is opened.

In an .npz the positions are called position or positions, particle types particle_type or particle_types, material
values material or material_property; only the first is needed. A folder holds one trajectory a file, and folders called
train, valid and test in it are the splits.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.metadata import read_stated
from gns_pl.convert.formats.npy import map_numbers, members, open_member, read_numbers
from gns_pl.convert.formats.source import (
    UNCERTAIN_MATERIAL,
    ForeignSet,
    Recording,
    checked_material,
    checked_types,
    without_material,
)
from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES, ParticleType
from gns_pl.io import SPLITS

POSITIONS = ("position", "positions")
TYPES = ("particle_type", "particle_types")
MATERIALS = (*MATERIAL_FEATURES, "material", "material_property")


def open_arrays(path: Path, files: Sequence[Path]) -> ForeignSet:
    """Return a set of .npy and .npz files, a trajectory each.

    Args:
        path: folder or file, as the user named it.
        files: of it.
    """
    folder = path if path.is_dir() else path.parent
    names = [(split_of(file, folder), str(file.relative_to(folder))) for file in files]
    stated, of_split = read_stated(folder, {split for split, _ in names})

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(files[number])

    return ForeignSet("plain arrays", path, tuple(names), opener, stated, of_split)


def split_of(file: Path, folder: Path) -> str:
    """Return the split a file is in: its own name, or the folder between it and the set's; "" for none."""
    parts = (*file.relative_to(folder).parent.parts, file.stem)
    return next((part for part in parts if part in SPLITS), "")


@contextmanager
def _open(file: Path) -> Iterator[Recording]:
    if file.suffix == ".npy":
        yield _recording({POSITIONS[0]: map_numbers(file)})
        return
    found = members(file)
    wanted = {name: member for name, member in found.items() if name in (*POSITIONS, *TYPES, *MATERIALS)}
    arrays = {}
    with zipfile.ZipFile(file) as archive:
        for name, member in wanted.items():
            with open_member(archive, member) as (stream, header, stored):
                arrays[name] = read_numbers(stream, header, stored, name)
    if not any(name in arrays for name in POSITIONS):
        raise InputError(f"has no array called position, but {', '.join(found)[:80] or 'none at all'}.")
    yield _recording(arrays)


def _recording(arrays: dict[str, NDArray[Any]]) -> Recording:
    def named(names: Sequence[str]) -> NDArray[Any] | None:
        return next((arrays[name] for name in names if name in arrays), None)

    position, types, material = named(POSITIONS), named(TYPES), named(MATERIALS)
    if position is None or position.ndim != 3:
        shape = None if position is None else list(position.shape)
        one = "; a file is a trajectory: stack its frames in their order" if shape and len(shape) == 2 else ""
        raise InputError(f"positions must be [T, N, D], not {shape}{one}.")
    number = position.shape[1]
    sure = MATERIAL_FEATURES[0] in arrays  # a name that says what the values are
    features = () if material is None else MATERIAL_FEATURES[:1] if sure else (UNCERTAIN_MATERIAL,)
    return Recording(
        num_frames=position.shape[0],
        particle_type=checked_types(np.array(int(ParticleType.SAND)) if types is None else types, number),
        read=lambda start, stop: position[start:stop],
        dim=position.shape[2],
        material=without_material(number) if material is None else checked_material(material, number),
        material_features=features,
        dtype=str(position.dtype),
        notes=() if types is not None else ("no particle types are stored; all particles are taken for sand, type 6",),
    )


def _open_source(source: Source) -> ForeignSet | None:
    files = sorted([*source.files.get(".npz", []), *source.files.get(".npy", [])])
    return open_arrays(source.path, files) if files else None


FORMAT = Format("plain arrays (.npy, .npz)", (".npy", ".npz"), _open_source)
