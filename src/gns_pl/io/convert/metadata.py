"""metadata.json, which sets of geoelements/gns, LagrangeBench and DeepMind have beside their data, in their units."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.io.convert.source import Stated, reading
from gns_pl.io.regular import read_bounded

NAME = "metadata.json"
MOST_BYTES = 10_000_000
"""A larger metadata.json is none."""


def read_json(path: Path) -> dict[str, Any]:
    """Return a JSON file that holds an object.

    Raises:
        InputError: no such file, too large for what it should be, or not an object; the file is named.
    """
    with reading(path):
        content = json.loads(read_bounded(path, MOST_BYTES, "settings"))
        if not isinstance(content, dict):
            raise InputError("must hold an object of names and values.")
        return content


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the metadata of a folder, that of "rollout" over that of "train" where they are apart; {} if none.

    Raises:
        InputError: a file that is there and cannot be used.
    """
    path = folder / NAME
    if not path.exists() and not path.is_symlink():
        return {}
    content = read_json(path)
    parts = [content[key] for key in ("train", "rollout") if isinstance(content.get(key), Mapping)]
    for part in parts:
        content = {**content, **part}
    return {key: value for key, value in content.items() if key not in ("train", "rollout")} if parts else content


def stated_of(metadata: Mapping[str, Any], path: Path) -> Stated:
    """Return what the keys that all three share say.

    Args:
        metadata: as `read_metadata`.
        path: for messages.

    Raises:
        InputError: values of another form than they should have.
    """
    with reading(path):
        dt = positive(metadata, "dt")
        every = positive(metadata, "write_every")
        lower, upper = _bounds(metadata)
        periodic = metadata.get("periodic_boundary_conditions", ())
        return Stated(
            dt=None if dt is None else dt * (every or 1.0),
            lower=lower,
            upper=upper,
            spacing=positive(metadata, "dx"),
            radius=positive(metadata, "default_connectivity_radius"),
            periodic=tuple(bool(axis) for axis in periodic),
            metadata=dict(metadata),
        )


def _bounds(metadata: Mapping[str, Any]) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    if "bounds" not in metadata:
        return None, None
    bounds = np.asarray(metadata["bounds"], dtype=np.float64)
    dim = int(metadata.get("dim", len(bounds)))
    if bounds.ndim != 2 or bounds.shape[1:] != (2,) or not 2 <= dim <= len(bounds):
        raise InputError("bounds must be a pair of numbers for each axis.")
    bounds = bounds[:dim]
    if not np.isfinite(bounds).all() or not (bounds[:, 0] < bounds[:, 1]).all():
        raise InputError("bounds must be finite, the lower one below the upper.")
    return tuple(bounds[:, 0].tolist()), tuple(bounds[:, 1].tolist())


def positive(metadata: Mapping[str, Any], key: str) -> float | None:
    """Return a positive number, None where it is not there.

    Raises:
        InputError: something else.
    """
    value = metadata.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or not value > 0:
        raise InputError(f"{key} must be a positive number, not {value!r}.")
    return float(value)


def frame_statistics(metadata: Mapping[str, Any], dim: int) -> dict[str, NDArray[np.float64]]:
    """Return vel_mean, vel_std, acc_mean and acc_std [D], in units of length and frames.

    Args:
        metadata: as `read_metadata`.
        dim: D.

    Raises:
        InputError: one is missing or of another form.
    """
    found = {}
    for key in ("vel_mean", "vel_std", "acc_mean", "acc_std"):
        if key not in metadata:
            raise InputError(f"{NAME} lacks {key}.")
        values = np.asarray(metadata[key], dtype=np.float64).reshape(-1)
        if values.shape != (dim,) or not np.isfinite(values).all():
            raise InputError(f"{key} must be {dim} finite numbers, not {metadata[key]!r}.")
        found[key] = values
    return found
