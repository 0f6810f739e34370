"""geoelements/gns: train.npz, valid.npz, test.npz with pickled trajectories, or the same as .h5, and metadata.json.

A member of an .npz is a trajectory, an array of two or three objects: positions [T, N, D], particle types [N] or one
for all, and if need be tan φ [N] or one for all. Or there is one member, `gns_data`, with a row of these for each
trajectory. All of it is pickled, so that it is read on demand only (`pickled`).
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.groups import group_names, open_group
from gns_pl.convert.formats.limits import check_claim, check_memory
from gns_pl.convert.formats.metadata import read_stated
from gns_pl.convert.formats.npy import members, open_member, read_numbers
from gns_pl.convert.formats.pickled import plain, read_pickle, write_pickle
from gns_pl.convert.formats.source import (
    UNCERTAIN_MATERIAL,
    ForeignSet,
    Recording,
    checked_material,
    checked_types,
    reading,
    without_material,
)
from gns_pl.errors import InputError
from gns_pl.io import SPLITS

WHOLE = "gns_data"
"""Member that holds all trajectories of a file."""

Opener = Callable[[], AbstractContextManager[Recording]]


def open_geoelements(path: Path, files: Sequence[Path], *, trust: bool) -> ForeignSet:
    """Return a set of .npz or .h5 files.

    Args:
        path: folder or file, as the user named it.
        files: of it, each a split by its name.
        trust: read pickled arrays, by an unpickler that rebuilds NumPy's arrays and runs nothing else.

    Raises:
        InputError: a file that cannot be used, or pickled arrays without `trust`.
    """
    names: list[tuple[str, str]] = []
    openers: list[Opener] = []
    for file in files:
        split = file.stem if file.stem in SPLITS else ""
        with reading(file):
            found = _of_npz(file, trust) if file.suffix == ".npz" else _of_hdf5(file)
        names += [(split, f"{file.name}/{name}") for name in found]
        openers += found.values()
    folder = path if path.is_dir() else path.parent
    stated, of_split = read_stated(folder, {split for split, _ in names})
    return ForeignSet("geoelements/gns", path, tuple(names), lambda number: openers[number](), stated, of_split)


def _of_hdf5(file: Path) -> dict[str, Opener]:
    def opener(name: str) -> Opener:
        return lambda: open_group(file, name, position="positions", material="material_property")

    return {name: opener(name) for name in group_names(file, "positions")}


def _of_npz(file: Path, trust: bool) -> dict[str, Opener]:
    found = members(file)
    if WHOLE not in found:
        if found:
            _check_trust(file, next(iter(found.values())), trust)
        return {name: _member(file, member) for name, member in found.items()}
    _check_trust(file, found[WHOLE], trust)
    rows = _read_member(file, found[WHOLE])
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise InputError(f"{WHOLE} must hold a row for each trajectory.")

    def opener(row: list[Any]) -> Opener:
        return lambda: _made(row)

    return {f"{WHOLE}_{number}": opener(row) for number, row in enumerate(rows)}


def _check_trust(file: Path, member: str, trust: bool) -> None:
    with zipfile.ZipFile(file) as archive, open_member(archive, member) as (_, header, _):
        if header.dtype.hasobject and not trust:
            raise InputError(
                "holds pickled Python objects, as geoelements/gns saves them, and to open these may run whatever code "
                "stands in them; with trust=true NumPy's arrays, and nothing else, are read from it."
            )


def _member(file: Path, member: str) -> Opener:
    @contextmanager
    def opener() -> Iterator[Recording]:
        with _made(_read_member(file, member)) as recording:
            yield recording

    return opener


def _read_member(file: Path, member: str) -> Any:
    """Return the content of a member as nested lists of arrays."""
    with zipfile.ZipFile(file) as archive, open_member(archive, member) as (stream, header, stored):
        if header.dtype.hasobject:
            check_memory(3 * stored, member)
            check_claim(len(header.shape) and max(header.shape), stored, member)
            return plain(read_pickle(cast(BinaryIO, stream)))
        values = read_numbers(stream, header, stored, member)
    if values.dtype.names is None:
        raise InputError(f"{member} holds numbers alone, not a trajectory with its particle types.")
    return [[row[name] for name in values.dtype.names] for row in values.reshape(-1)]


@contextmanager
def _made(parts: Any) -> Iterator[Recording]:
    """Yield the trajectory of [positions, particle types, maybe material values]."""
    if isinstance(parts, list) and len(parts) == 1 and isinstance(parts[0], list):
        parts = parts[0]
    arrays = isinstance(parts, list) and all(isinstance(each, np.ndarray) for each in parts)
    if not arrays or len(parts) not in (2, 3):
        raise InputError(
            "must hold positions, particle types and at most one material value; the number of particles must not "
            "change from frame to frame."
        )
    position: NDArray[Any] = parts[0]
    if position.ndim != 3:
        raise InputError(f"positions must be [T, N, D], not {list(position.shape)}.")
    frames, number, dim = position.shape
    has_material = len(parts) == 3
    yield Recording(
        num_frames=frames,
        particle_type=checked_types(parts[1], number),
        read=lambda start, stop: position[start:stop],
        dim=dim,
        material=checked_material(parts[2], number) if has_material else without_material(number),
        material_features=(UNCERTAIN_MATERIAL,) if has_material else (),
        dtype=str(position.dtype),
    )


@contextmanager
def npz_writer(path: Path) -> Iterator[Callable[[str, Mapping[str, NDArray[Any]]], None]]:
    """Write an .npz trajectory by trajectory, each as long in memory as it is written.

    Args:
        path: of the file, made here.

    Yields:
        A function to call with a name and the arrays "position" [T, N, D], "particle_type" [N] and maybe "material"
        [N].
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:

        def add(name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
            parts = [arrays[key] for key in ("position", "particle_type", "material") if key in arrays]
            row = np.empty(len(parts), dtype=object)
            for place, part in enumerate(parts):
                row[place] = part
            info = zipfile.ZipInfo(f"{name}.npy")  # with a fixed date: the same set is the same bytes
            info.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(info, "w", force_zip64=True) as member:
                header = np.lib.format.header_data_from_array_1_0(row)
                np.lib.format.write_array_header_1_0(cast(BinaryIO, member), header)
                write_pickle(cast(BinaryIO, member), row)

        yield add


def _open_source(source: Source) -> ForeignSet | None:
    files, archives = source.files.get(".h5", []), source.files.get(".npz", [])
    if files:
        with reading(files[0]):
            if group_names(files[0], "positions"):
                return open_geoelements(source.path, files, trust=False)
            raise InputError("is HDF5, but has no groups with position (LagrangeBench) or positions (geoelements/gns).")
    if archives and _holds_sets(archives[0]):
        return open_geoelements(source.path, archives, trust=source.trust)
    return None


def _holds_sets(archive: Path) -> bool:
    """Return whether an .npz holds pickled trajectories, or one array of all."""
    with reading(archive):
        found = members(archive)
        if WHOLE in found:
            return True
        with zipfile.ZipFile(archive) as opened:
            for member in found.values():
                with open_member(opened, member) as (_, header, _):
                    return bool(header.dtype.hasobject)
    return False


FORMAT = Format("geoelements/gns (.npz, .h5)", (".npz", ".h5"), _open_source)
