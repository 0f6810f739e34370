"""HDF5 files with a group for each trajectory: LagrangeBench's, and version 2 of geoelements/gns. One walk for both."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.limits import LARGEST_RATIO, check_claim, check_memory, unpacked_gzip
from gns_pl.convert.formats.source import (
    UNCERTAIN_MATERIAL,
    Recording,
    checked_material,
    checked_types,
    without_material,
)
from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Yield a foreign HDF5 file, open for reading; one whose name ends in .gz is unpacked in memory.

    Raises:
        InputError: it is no regular file, or does not fit into memory unpacked.
    """
    regular_size(path)
    packed = path.suffix == ".gz"
    with h5py.File(io.BytesIO(unpacked_gzip(path)), "r") if packed else h5py.File(path, "r", locking=False) as file:
        yield file


def group_names(path: Path, dataset: str) -> list[str]:
    """Return the groups of a file that hold a data set of this name, in the file's order.

    Args:
        path: of the file.
        dataset: "position", "positions".
    """
    with open_hdf5(path) as file:
        return [name for name in file if _is_group(file, name) and dataset in file[name]]


def _is_group(file: Any, name: str) -> bool:
    return isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group)


def own_data(group: Any, name: str) -> Any:
    """Return a data set of numbers that is stored in this very file, as large as what is stored allows.

    Args:
        group: an open group.
        name: in the group.

    Raises:
        InputError: it is elsewhere, no numbers, or claims more than there is.
    """
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise InputError(f"{name} is a link into another place, which is not followed.")
    found = group[name]
    if not isinstance(found, h5py.Dataset):
        raise InputError(f"{name} is not a data set.")
    if found.external or found.is_virtual:
        raise InputError(f"{name} is stored in another file, which is not followed.")
    if found.dtype.kind not in "biufV" or found.dtype.hasobject:
        raise InputError(f"{name} must hold numbers, not {found.dtype}.")
    ratio = LARGEST_RATIO if found.id.get_create_plist().get_nfilters() else 1
    check_claim(found.size * found.dtype.itemsize, found.id.get_storage_size(), name, ratio=ratio)
    return found


def whole(group: Any, name: str) -> NDArray[Any]:
    """Return all of a data set (`own_data`)."""
    found = own_data(group, name)
    check_memory(2 * found.size * found.dtype.itemsize, name)
    return np.asarray(found[()])


@contextmanager
def open_group(path: Path, name: str, *, position: str, material: str | None) -> Iterator[Recording]:
    """Yield the trajectory of a group.

    Args:
        path: of the file.
        name: of the group.
        position: name of its positions [T, N, D].
        material: name of its material values, if it has any.
    """
    with open_hdf5(path) as file:
        group = file[name]
        frames = own_data(group, position)
        if frames.ndim != 3:
            raise InputError(f"{position} must be [T, N, D], not {list(frames.shape)}.")
        number = frames.shape[1]
        check_memory(4 * number * frames.shape[2] * frames.dtype.itemsize, position)
        has_material = material is not None and material in group
        yield Recording(
            num_frames=frames.shape[0],
            particle_type=checked_types(whole(group, "particle_type"), number),
            read=lambda start, stop: frames[start:stop],
            dim=frames.shape[2],
            material=checked_material(whole(group, str(material)), number)
            if has_material
            else without_material(number),
            material_features=(UNCERTAIN_MATERIAL,) if has_material else (),
            dtype=str(frames.dtype),
        )
