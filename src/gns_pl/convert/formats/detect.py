"""Which format a path is in, by what lies there and not by what the user has to know."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from gns_pl.convert.formats import cb_geo, geoelements, lagrangebench
from gns_pl.convert.formats.arrays import open_arrays
from gns_pl.convert.formats.cb_geo_runs import find_runs
from gns_pl.convert.formats.groups import group_names, open_hdf5
from gns_pl.convert.formats.learning_to_simulate import open_learning_to_simulate
from gns_pl.convert.formats.npy import members, open_member
from gns_pl.convert.formats.ours import open_ours
from gns_pl.convert.formats.source import ForeignSet, reading
from gns_pl.convert.formats.vtk import ENDINGS, open_vtk
from gns_pl.errors import InputError
from gns_pl.io import MANIFEST_NAME
from gns_pl.io.regular import regular_size
from gns_pl.io.schema import FORMAT_NAME

MOST_FILES = 1_000_000
KNOWN = (".tfrecord", ".pvd", *ENDINGS, ".h5", ".npz", ".npy")
PACKED = (".gz", ".bz2", ".xz", ".zst", ".zip")


def open_set(
    source: str | Path, *, trust: bool = False, deck: str | Path | None = None, lost: str = "refuse"
) -> ForeignSet:
    """Return what a path holds, whatever format it is in.

    Args:
        source: file or folder.
        trust: read pickled arrays of geoelements/gns, without running anything that stands in them.
        deck: JSON input of CB-Geo MPM runs, or of a VTK series of one; None looks for those of runs.
        lost: what to do with particles that left CB-Geo's mesh: "refuse" the run, or "drop" them from all frames.

    Raises:
        InputError: nothing there, or nothing that is known; the path is named.
    """
    path = Path(source)
    if not path.exists():
        raise InputError(f"{path}: there is no such file or folder.")
    if path.is_dir() and (path / MANIFEST_NAME).is_file():
        return open_ours(path)
    folders = find_runs(path)
    if folders:
        return cb_geo.open_cb_geo(path, folders, deck=None if deck is None else Path(deck), lost=lost)
    files = _files(path)
    _check_packed(path, files)
    frames = files.get(".pvd") or sorted(file for ending in ENDINGS for file in files.get(ending, []))
    if frames and not files.get(".tfrecord"):
        return open_vtk(path, frames, deck=None if deck is None else Path(deck))
    if deck is not None:
        raise InputError(f"{path}: holds no runs of CB-Geo MPM and no VTK series of one, to which deck= belongs.")
    if files.get(".tfrecord"):
        return open_learning_to_simulate(path, files[".tfrecord"])
    if files.get(".h5"):
        return _open_hdf5(path, files[".h5"])
    archives = files.get(".npz", [])
    if archives and _holds_sets(archives[0]):
        return geoelements.open_geoelements(path, archives, trust=trust)
    arrays = sorted([*archives, *files.get(".npy", [])])
    if arrays:
        return open_arrays(path, arrays)
    raise InputError(
        f"{path}: holds none of the formats that are known: geoelements/gns (.npz, .h5), LagrangeBench (.h5), DeepMind "
        "(.tfrecord), CB-Geo MPM (particles….h5), VTK (.pvd, .vtp, .vtu), plain arrays (.npy, .npz) and gns_pl's own."
    )


def _files(path: Path) -> dict[str, list[Path]]:
    """Return ending → files of a folder, one level of folders in it among them, or a file alone.

    Raises:
        InputError: a file of a known ending that is none: a pipe, a device, a link to nothing.
    """
    if not path.is_dir():
        with reading(path):
            regular_size(path)
        return {path.suffix: [path]}
    found: dict[str, list[Path]] = {}
    for count, file in enumerate(sorted([*path.glob("*"), *path.glob("*/*")])):
        if count > MOST_FILES:
            raise InputError(f"{path}: has more than {MOST_FILES:,} files.")
        if file.name.startswith(".") or file.is_dir():
            continue
        if file.suffix in KNOWN:
            with reading(file):
                regular_size(file)
        found.setdefault(file.suffix, []).append(file)
    order = {"train": 0, "valid": 1, "test": 2}
    return {ending: sorted(files, key=lambda file: (order.get(file.stem, 3), file)) for ending, files in found.items()}


def _check_packed(path: Path, files: Mapping[str, Sequence[Path]]) -> None:
    """Refuse data that would be left out because it is packed and does not lie there unpacked as well.

    Raises:
        InputError: such a file.
    """
    for ending in PACKED:
        for file in files.get(ending, ()):
            plain = file.with_suffix("")
            if plain.suffix in KNOWN and not plain.exists():
                raise InputError(f"{path}: {file.name} is packed and would be left out; unpack it, or take it away.")


def _open_hdf5(path: Path, files: list[Path]) -> ForeignSet:
    first = files[0]
    with reading(first):
        with open_hdf5(first) as file:
            own = file.attrs.get("format") == FORMAT_NAME
        if own and path.is_file():
            return open_ours(path)
        stored = sorted(each.parent for each in path.glob(f"*/{MANIFEST_NAME}")) if own else []
        if stored:
            raise InputError(f"is of a data set of gns_pl, of which {path} has {len(stored)}; name one: {stored[0]}")
        if own:
            raise InputError(
                f"is a trajectory of gns_pl, but {path} has no {MANIFEST_NAME}; name the files one by one."
            )
        if group_names(first, lagrangebench.POSITION):
            return lagrangebench.open_lagrangebench(path, files)
        if group_names(first, "positions"):
            return geoelements.open_geoelements(path, files, trust=False)
        raise InputError("is HDF5, but has no groups with position (LagrangeBench) or positions (geoelements/gns).")


def _holds_sets(archive: Path) -> bool:
    """Return whether an .npz is of geoelements/gns: pickled trajectories, or one array of all."""
    with reading(archive):
        found = members(archive)
        if geoelements.WHOLE in found:
            return True
        with zipfile.ZipFile(archive) as opened:
            for member in found.values():
                with open_member(opened, member) as (_, header, _):
                    return bool(header.dtype.hasobject)
    return False
