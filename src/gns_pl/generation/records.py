"""What a data set's folder says about itself while and after it is generated, and whether it is the one asked for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.generation.pool import Failure
from gns_pl.generation.spec import DatasetSpec
from gns_pl.io import MANIFEST_NAME, StorageError, read_manifest
from gns_pl.io.atomic import write_atomically
from gns_pl.mpm.settings import solver_version

BEGUN_NAME = "generation.json"
FAILURES_NAME = "failures.log"
TIMINGS_NAME = "timings.csv"


def stored_folders(folder: Path, dataset: DatasetSpec) -> dict[int, Path]:
    """Return k → folder of the data set of every k-th point: `folder` itself if all points are all that is stored."""
    if dataset.store_every == (1,):
        return {1: folder}
    return {every: folder / f"every_{every}" for every in dataset.store_every}


def is_finished(folder: Path, dataset: DatasetSpec) -> bool:
    """Return whether `folder` holds all that is to be stored; sums are not computed (`verify_dataset` does that).

    Raises:
        InputError: it holds another data set, or a damaged manifest.
    """
    return all(_is_complete(stored, dataset) for stored in stored_folders(folder, dataset).values())


def _is_complete(stored: Path, dataset: DatasetSpec) -> bool:
    if not (stored / MANIFEST_NAME).exists():
        return False
    manifest = read_manifest(stored)
    _check_same(stored, manifest.spec, dataset)
    return all((stored / name).is_file() for name in manifest.files)


def check_folder(folder: Path, dataset: DatasetSpec) -> None:
    """Check that `dataset` may be generated in `folder`; nothing is written.

    Raises:
        InputError: it holds another data set, something else, or one begun with another version of the solver.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file, not a folder.")
    path = folder / BEGUN_NAME
    if not path.exists():
        if any((stored / MANIFEST_NAME).exists() for stored in stored_folders(folder, dataset).values()):
            raise InputError(f"{folder}: lacks files of its manifest and {BEGUN_NAME}, so copy the whole folder again.")
        if folder.exists() and any(not entry.name.startswith(".") for entry in folder.iterdir()):
            raise InputError(f"{folder}: is not empty and not a data set of gns_pl; choose another folder.")
        return
    try:
        begun = json.loads(path.read_text(encoding="utf-8"))
        spec, version = dict(begun["spec"]), str(begun["solver_version"])
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: is damaged or not of gns_pl.") from error
    _check_same(folder, spec, dataset)
    here = solver_version(dataset.mpm)
    if version != here:
        raise InputError(
            f"{folder}: was begun with another version of the solver ({version}, this is {here}); "
            f"remove the folder, or choose another one."
        )


def claim_folder(folder: Path, dataset: DatasetSpec) -> None:
    """Check `folder` again, write down what is generated in it, and make the folders that are stored.

    The caller holds the folder's lock.

    Raises:
        InputError: as `check_folder`.
        StorageError: the disk refuses.
    """
    check_folder(folder, dataset)
    if not (folder / BEGUN_NAME).exists():
        text = json.dumps({"solver_version": solver_version(dataset.mpm), "spec": dataset.to_dict()}, indent=1) + "\n"
        write_atomically(folder / BEGUN_NAME, text.encode())
    for stored in stored_folders(folder, dataset).values():
        make_folder(stored)


def make_folder(folder: Path) -> None:
    """Make `folder` where it is not there.

    Raises:
        StorageError: the disk refuses.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder}: cannot be made ({error.strerror}).") from error


def append_timing(folder: Path, file_name: str, wall_seconds: float) -> None:
    """Note how long the solver took for a file; kept out of the file, which is the same bytes every time.

    Raises:
        StorageError: the disk refuses.
    """
    path = folder / TIMINGS_NAME
    try:
        with path.open("a", encoding="utf-8") as file:
            if file.tell() == 0:
                file.write("file,wall_seconds\n")
            file.write(f"{file_name},{wall_seconds:.3f}\n")
    except OSError as error:
        raise StorageError(f"{path}: cannot be written ({error.strerror}).") from error


def read_timings(folder: Path) -> float | None:
    """Return the solver's time for all trajectories of a data set [s], each on one core or its share of a GPU.

    Args:
        folder: of the set, or of one of its stored lattices; one that was copied without its timings gives None.
    """
    path = next(
        (directory / TIMINGS_NAME for directory in (folder, folder.parent) if (directory / TIMINGS_NAME).is_file()),
        None,
    )
    if path is None:
        return None
    try:
        rows = [line.rsplit(",", 1) for line in path.read_text(encoding="utf-8").splitlines()[1:]]
        return sum({name: float(seconds) for name, seconds in rows}.values())  # of a file made again, the last time
    except (OSError, ValueError):
        return None


def write_failures(folder: Path, failures: Mapping[str, Failure]) -> None:
    """Write the failures of this run with their tracebacks, or remove those of an earlier run."""
    path = folder / FAILURES_NAME
    if not failures:
        path.unlink(missing_ok=True)
    elif not any(failure.final for failure in failures.values()):
        text = "\n".join(f"{name}: {failure.message}\n{failure.details}" for name, failure in failures.items())
        write_atomically(path, text.encode())


def first_difference(there: Any, here: Any, key: str = "") -> str | None:
    """Return the first key at which two plain structures differ and the two values, in words; None if they agree."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        for name in sorted({*there, *here}):
            below = f"{key}.{name}" if key else str(name)
            if name not in there or name not in here:
                return f"{below} is only {'there' if name in there else 'asked for'}"
            difference = first_difference(there[name], here[name], below)
            if difference is not None:
                return difference
        return None
    return None if there == here else f"{key} is {there} there and {here} is asked for"


def _check_same(folder: Path, there: Mapping[str, Any], dataset: DatasetSpec) -> None:
    difference = first_difference(there, dataset.to_dict())
    if difference is not None:
        raise InputError(f"{folder}: holds another data set ({difference}); choose another folder, or remove it.")
