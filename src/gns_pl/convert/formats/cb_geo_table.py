"""The table of particles in a CB-Geo file: columns by name, rows by the particle's id, files of all ranks joined."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.groups import open_hdf5, own_data, whole
from gns_pl.convert.formats.source import reading
from gns_pl.errors import InputError

TABLE = "table"
NEEDED = ("id", "coord_x", "coord_y", "coord_z")
OPTIONAL = (
    "mass", "volume", "displacement_x", "displacement_y", "displacement_z", "velocity_x", "velocity_y", "velocity_z",
    "material_id",
)  # fmt: skip
WHOLE_NUMBERS = ("id", "material_id")


def read_table(files: tuple[Path, ...]) -> NDArray[Any]:
    """Return the rows of a step [N] by rising id.

    Args:
        files: one a rank.

    Raises:
        InputError: no such table, or an id twice.
    """
    parts = []
    for path in files:
        with reading(path), open_hdf5(path) as file:
            rows = whole(file, TABLE)
            columns = rows.dtype.names or ()
            missing = [name for name in NEEDED if name not in columns]
            if rows.ndim != 1 or missing:
                raise InputError(f"its table lacks {', '.join(missing) or 'rows'}; it is not one of particles.")
            kept = [name for name in (*NEEDED, *OPTIONAL) if name in columns]
            kinds = [(name, np.int64 if name in WHOLE_NUMBERS else np.float64) for name in kept]
            part = np.empty(len(rows), dtype=kinds)
            for name in kept:
                if rows.dtype[name].kind not in ("iu" if name in WHOLE_NUMBERS else "iuf") or rows.dtype[name].shape:
                    raise InputError(f"{name} in its table must hold numbers, not {rows.dtype[name]}.")
                with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is refused as not finite
                    part[name] = rows[name]
            parts.append(part)
    if any(part.dtype != parts[0].dtype for part in parts):
        raise InputError(f"{files[0].name} and the other ranks' files have different columns.")
    joined = np.concatenate(parts)
    joined = joined[np.argsort(joined["id"], kind="stable")]
    _check_unique(joined["id"], files)
    return joined


def read_ids(files: tuple[Path, ...]) -> NDArray[np.int64]:
    """Return the ids of a step's particles [N], rising, without reading what else its rows hold.

    Args:
        files: one a rank.

    Raises:
        InputError: no such table, or an id twice.
    """
    parts = []
    for path in files:
        with reading(path), open_hdf5(path) as file:
            rows = own_data(file, TABLE)
            if rows.ndim != 1 or "id" not in (rows.dtype.names or ()) or rows.dtype["id"].kind not in "iu":
                raise InputError("its table lacks id; it is not one of particles.")
            parts.append(np.asarray(rows.fields("id")[()]).astype(np.int64))
    ids = np.sort(np.concatenate(parts))
    _check_unique(ids, files)
    return ids


def count_rows(files: tuple[Path, ...]) -> int:
    """Return how many particles a step has."""
    number = 0
    for path in files:
        with reading(path), open_hdf5(path) as file:
            number += len(own_data(file, TABLE))
    return number


def _check_unique(ids: NDArray[np.int64], files: tuple[Path, ...]) -> None:
    if (np.diff(ids) == 0).any():
        raise InputError(f"{files[0].name}: a particle's id is there twice.")


def has_vector(rows: NDArray[Any], prefix: str) -> bool:
    """Return whether a table has the three columns of a vector, as displacement_x."""
    return all(f"{prefix}_{axis}" in (rows.dtype.names or ()) for axis in "xyz")


def vector(rows: NDArray[Any], prefix: str, dim: int) -> NDArray[np.float64]:
    """Return the columns of a vector [N, D]."""
    return np.stack([rows[f"{prefix}_{axis}"] for axis in "xyz"[:dim]], axis=1)
