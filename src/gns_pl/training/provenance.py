"""Where a trained model came from, as its checkpoints store it."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gns_pl.io import manifest_sha256
from gns_pl.training.clock import cost_of

PACKAGES = ("gns_pl", "torch", "torch-geometric", "lightning", "numpy", "numba", "h5py")


def provenance(settings: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """Return versions, commit, config and the hash of the dataset's manifest."""
    try:
        commit = subprocess.run(
            ["git", "describe", "--always", "--dirty"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "unknown"
    return {
        "description": settings["description"],
        "versions": {name: version(name) for name in PACKAGES},
        "commit": commit,
        "config": dict(settings),
        "manifest_sha256": manifest_sha256(directory),
        "cost": cost_of(directory),
    }
