"""Which data set a config means: one to generate, or a folder that is there, whatever made it.

A folder is meant where the config has no families of scenes: `convert.py` made it, or another run of `generate.py`. Its
manifest then says what it is; the config only says where (conf/data/imported.yaml).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.generation.dataset import generate_dataset
from gns_pl.io import MANIFEST_NAME, read_manifest

OPTION = "imported"
"""Of the config group `data`, for folders."""


def is_dataset(path: str) -> bool:
    """Return whether a folder with a manifest is there under a name."""
    try:
        return bool(path) and (Path(path) / MANIFEST_NAME).is_file()
    except (OSError, ValueError):
        return False


def is_imported(data: Mapping[str, Any]) -> bool:
    """Return whether data were made elsewhere, so that no solver of ours can make more of them."""
    return "imported" in data


def resolved_data(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the specification of a data set; for a folder that of its manifest, with "root".

    Args:
        data: conf/data as plain values.

    Raises:
        InputError: neither families nor a folder with a manifest that says what it holds.
    """
    if "families" in data:
        return dict(data)
    root = data.get("root")
    if not isinstance(root, str) or not root:
        raise InputError("data: name a data set, or a folder that convert.py made: data=datasets/NAME")
    folder = Path(root)
    spec = dict(read_manifest(folder).spec)
    every = re.fullmatch(r"every_(\d+)", folder.name)
    if "families" in spec and "store_every" in spec and every:  # one of several that are stored
        return {**spec, "root": str(folder.parent), "every": int(every[1])}
    if "families" not in spec and not {"imported", "gravity"} <= set(spec):
        raise InputError(f"{folder}: its manifest does not say what it holds (spec.imported, spec.gravity).")
    return {**spec, "root": root}


def find_dataset(data: Mapping[str, Any], *, device: str = "auto", progress: bool = True) -> Path:
    """Return the folder of a data set with its manifest, generated where that is possible and it is not there.

    Args:
        data: as `resolved_data` returns it.
        device: for `generate_dataset`.
        progress: for `generate_dataset`.

    Raises:
        InputError: an imported set that is not there, or as `generate_dataset`.
    """
    if not is_imported(data):
        return generate_dataset(data, device=device, progress=progress)
    read_manifest(data["root"])
    return Path(data["root"])
