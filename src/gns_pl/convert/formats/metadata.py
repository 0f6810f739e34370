"""metadata.json, which sets of geoelements/gns, LagrangeBench and DeepMind have beside their data, in their units."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.source import Stated, reading
from gns_pl.errors import InputError
from gns_pl.io.regular import read_bounded

NAME = "metadata.json"
PARTS = ("train", "rollout")
"""What geoelements/gns may say of training and of rollouts apart, each with a box and a time step of its own."""
PART_OF_SPLIT = {"train": "train", "": "train", "valid": "train", "test": "rollout"}
"""Split → the part that speaks for it: validation is drawn as training is."""
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


def read_metadata(folder: Path, part: str = "train") -> dict[str, Any]:
    """Return the metadata of a folder, or one of the two parts that geoelements/gns may have in it; {} if none.

    Args:
        folder: of the data.
        part: "train" or "rollout"; where the file has the other part alone, that.

    Raises:
        InputError: a file that is there and cannot be used.
    """
    path = folder / NAME
    there = path.exists() or path.is_symlink()  # a link to nothing is told
    return part_of(read_json(path), part) if there else {}


def part_of(content: Mapping[str, Any], part: str) -> dict[str, Any]:
    """Return a part of what a metadata.json holds, over what stands beside the parts; all of it without parts."""
    parts = {key: content[key] for key in PARTS if isinstance(content.get(key), Mapping)}
    if not parts:
        return dict(content)
    common = {key: value for key, value in content.items() if key not in PARTS}
    return {**common, **parts.get(part, next(iter(parts.values())))}


def read_stated(folder: Path, splits: Collection[str]) -> tuple[Stated, dict[str, Stated]]:
    """Return what metadata.json says of a set, which is what it says of the training; and of each split, if it differs.

    Args:
        folder: of the data.
        splits: that the set has; "" stands for none.

    Raises:
        InputError: a file that is there and cannot be used.
    """
    of_split = {split: stated_of(read_metadata(folder, PART_OF_SPLIT[split]), folder / NAME) for split in splits}
    first = next((of_split[split] for split in PART_OF_SPLIT if split in of_split), Stated())
    return first, of_split if any(stated != first for stated in of_split.values()) else {}


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
            origin=_origin(metadata, lower),
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


def _origin(metadata: Mapping[str, Any], lower: tuple[float, ...] | None) -> tuple[float, ...]:
    """Return what our own export says was taken off all positions [D]; empty if it says nothing."""
    origin = np.asarray(metadata.get("origin", ()), dtype=np.float64)
    if origin.ndim != 1 or not np.isfinite(origin).all() or (len(origin) and lower and len(origin) != len(lower)):
        raise InputError("origin must be a finite number for each axis.")
    return tuple(origin.tolist())


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
