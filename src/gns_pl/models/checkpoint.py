"""Checkpoints: a file that knows its model, its data and where it came from, and runs no code when it is read.

A Lightning checkpoint with one more key, "gns_pl": format version, simulator config, the data's specification and
provenance, all plain values, and what the network saw in training, which earlier files lack. `load_checkpoint` needs
that key and the weights alone.
"""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from gns_pl.errors import InputError
from gns_pl.graph import TrainingDistribution
from gns_pl.io import atomic_path
from gns_pl.models.registry import DEFAULT, build_simulator, kind_of
from gns_pl.models.shipped import CORRECTOR, CORRECTOR_KIND, find_checkpoint
from gns_pl.models.simulator import Simulator

KEY = "gns_pl"
FORMAT_VERSION = 4
PREFIX = "simulator."


RETIRED = ("pairs", "held", "mean")
"""Values of model.output and model.aggregation that were removed: they made no better simulator (docs/training.md)."""


@dataclass(frozen=True)
class Checkpoint:
    """What a checkpoint holds.

    Attributes:
        simulator: the simulator, in evaluation mode, on the CPU.
        data: the specification of the data it was trained on, as in conf/data/.
        provenance: versions, commit, resolved config, hash of the dataset's manifest, steps made.
        distribution: what the network saw in training (`Simulator.state`); None in files that do not say.
    """

    simulator: Simulator
    data: dict[str, Any]
    provenance: dict[str, Any]
    distribution: TrainingDistribution | None = None


def checkpoint_entry(
    simulator: Simulator,
    data: Mapping[str, Any],
    provenance: Mapping[str, Any],
    distribution: TrainingDistribution | None = None,
) -> dict[str, Any]:
    """Return what the trainer stores under `KEY`, plain values and tensors only; `simulator` tells kind and config."""
    kind = kind_of(simulator)
    entry: dict[str, Any] = {"format_version": 4, "kind": kind}
    if kind == DEFAULT:
        entry = {"format_version": 3}  # which earlier versions of gns_pl read as well
    entry |= {
        "config": simulator.config.to_dict(),
        "data": dict(data),
        "provenance": dict(provenance),
    }
    return entry if distribution is None else {**entry, "seen": distribution.to_dict()}


def save_checkpoint(path: str | Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint without trainer state, whole or not at all: weights, statistics, config, data, provenance."""
    weights = {PREFIX + name: value for name, value in checkpoint.simulator.state_dict().items()}
    entry = checkpoint_entry(checkpoint.simulator, checkpoint.data, checkpoint.provenance, checkpoint.distribution)
    with atomic_path(path) as temporary:
        torch.save({"state_dict": weights, KEY: entry}, temporary)


def read_content(path: str | Path) -> dict[str, Any]:
    """Read everything a checkpoint file holds, trainer state included, under `weights_only=True`.

    Raises:
        InputError: no such file, or not one of our checkpoints; the file is named.
    """
    path = find_checkpoint(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such checkpoint.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, zipfile.BadZipFile, RuntimeError, EOFError, OSError, ValueError) as error:
        raise InputError(f"{path}: is not a readable checkpoint, or was cut off while written.") from error
    entry = content.get(KEY) if isinstance(content, dict) else None
    if not isinstance(entry, dict) or "format_version" not in entry or "state_dict" not in content:
        raise InputError(f"{path}: is not a checkpoint of gns_pl (it has no entry {KEY!r}).")
    return dict(content)


def load_checkpoint(path: str | Path) -> Checkpoint:
    """Read a checkpoint, from the trainer or from `save_checkpoint`, under `weights_only=True`.

    Args:
        path: of the file, or the name of a model that comes with the package (`gns_pl.models.shipped`).

    Raises:
        InputError: no such file, not one of our checkpoints, or of a format that is not read; the file is named.
    """
    content = read_content(path)
    entry = content[KEY]
    if entry["format_version"] > FORMAT_VERSION:
        raise InputError(
            f"{path}: has format {entry['format_version']}, this version of gns_pl reads up to {FORMAT_VERSION}; "
            "install a newer gns_pl."
        )
    if entry["format_version"] < 3 and entry["config"]["context"]:
        raise InputError(
            f"{path}: was trained with other features of model.context (format {entry['format_version']}); "
            "train it anew."
        )
    if entry.get("kind") == CORRECTOR_KIND:
        raise InputError(
            f"{path}: is of the training of a corrector of coarse MPM, and no simulator; take the {CORRECTOR} file "
            "beside it."
        )
    try:
        simulator = build_simulator({"kind": entry.get("kind", DEFAULT), **_current(entry["config"], path)})
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    weights = {
        name.removeprefix(PREFIX): value for name, value in content["state_dict"].items() if name.startswith(PREFIX)
    }
    try:
        simulator.load_state_dict(weights)
    except RuntimeError as error:
        reason = "the file is damaged"
        if entry["config"].get("walls") == "contacts":
            reason += ", or from before contacts came behind the network's forces: then train it again"
        raise InputError(f"{path}: its weights do not fit its own configuration; {reason}.") from error
    distribution = TrainingDistribution.from_dict(entry["seen"]) if "seen" in entry else None
    return Checkpoint(simulator.eval(), entry["data"], entry["provenance"], distribution)


def _current(config: Mapping[str, Any], path: str | Path) -> dict[str, Any]:
    """Return a stored config without the keys that earlier versions had besides.

    Raises:
        InputError: it asks for what is no longer made.
    """
    given = {key: config[key] for key in ("output", "aggregation") if config.get(key) in RETIRED}
    if not given and config.get("static_edges") and "edge_update" not in config:
        given = {"static_edges": True}
    if given:
        what = ", ".join(f"model.{key}={value}" for key, value in given.items())
        raise InputError(f"{path}: was trained with {what}, which is no longer supported; train it again.")
    return {key: value for key, value in config.items() if key not in ("aggregation", "static_edges")}


def load_simulator(path: str | Path) -> Simulator:
    """Return the simulator of a checkpoint, ready to step.

    Raises:
        InputError: as `load_checkpoint`.
    """
    return load_checkpoint(path).simulator


def move(checkpoint: Checkpoint, device: str, option: str) -> None:
    """Move a checkpoint's simulator to a device.

    Args:
        checkpoint: moved in place.
        device: as torch names it; "auto" is a GPU where there is one.
        option: by which the user chose it, for messages.

    Raises:
        InputError: a device that is not there.
    """
    name = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    try:
        checkpoint.simulator.to(torch.device(name))
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"{option}={device} cannot be used here ({str(error).splitlines()[0]}).") from error
