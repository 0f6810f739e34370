"""`advise`: find the data set, or make it as training would, survey it, and say what to change."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from gns_pl.data.survey import survey_dataset
from gns_pl.errors import InputError
from gns_pl.generation import DatasetSpec, chosen_every, generate_dataset, is_imported, missing_bytes, resolved_data
from gns_pl.generation.records import first_difference
from gns_pl.io import MANIFEST_NAME, Manifest, read_manifest
from gns_pl.models.registry import simulator_config
from gns_pl.models.shipped import CORRECTOR_KIND
from gns_pl.text import command, override
from gns_pl.training.advice import report
from gns_pl.training.advice.derived import compute_advice
from gns_pl.training.advice.suggestions import suggest
from gns_pl.training.config import TrainingConfig
from gns_pl.training.train import check_model, choose_features

LARGE = 1e8
"""Data sets of more bytes are not generated for the sake of advice."""


def advise(cfg: DictConfig, output: Path) -> Path:
    """Report on the data set of a config and on what its settings mean for it; nothing is trained.

    A folder that holds a manifest is taken as it is, whatever made it; otherwise the data are generated.

    Args:
        cfg: the config of conf/train.yaml.
        output: folder of this run, where advice.json goes.

    Returns:
        Path of advice.json.

    Raises:
        InputError: settings or data that cannot be used.
    """
    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    if settings["model"].get("kind") == CORRECTOR_KIND:
        raise InputError("advise=true has no advice for a corrector of coarse MPM; leave it out.")
    training = TrainingConfig.from_dict(settings["training"])
    check_model(settings["model"])
    settings["data"] = resolved_data(settings["data"])
    directory = find_dataset(settings["data"])
    manifest = read_manifest(directory)
    names = manifest.splits["train"][: training.num_train]
    model = simulator_config({**settings["model"], **_of_data(manifest, settings["model"])})
    survey = survey_dataset(directory, manifest, names, radius=model.connectivity_radius)
    advice = compute_advice(
        survey, model, training, memory=machine_memory(), gravity=float(settings["data"]["gravity"])
    )
    notes, suggestions = find_notes(directory, manifest, settings, training), suggest(advice)
    path = output / "advice.json"
    report.write(path, directory, advice, notes, suggestions)
    report.show(advice, notes, suggestions, path)
    return path


def find_dataset(data: Mapping[str, Any]) -> Path:
    """Return the folder of a data set: the one there, whatever made it, or one generated now if it is small.

    Args:
        data: conf/data as plain values.

    Raises:
        InputError: as `generate_dataset`, or data that are not there and large.
    """
    root = Path(data["root"])
    for place in (root / f"every_{chosen_every(data)}", root):
        if (place / MANIFEST_NAME).is_file():
            return place
    size = missing_bytes(data)
    if size > LARGE:
        typed = f"{override('data', data['name'])} {override('data.root', root)}"
        raise InputError(
            f"{root}: the data are not there, and advice is about data; to generate them, {size / 1e9:.2g} GB, type "
            f"{command('generate')} {typed}, which shows how long it takes."
        )
    return generate_dataset(data, device="auto")


def find_notes(directory: Path, manifest: Manifest, settings: Mapping[str, Any], training: TrainingConfig) -> list[str]:
    """Return sentences about how the data set and the settings fit together.

    Args:
        directory: of the data set.
        manifest: of the folder.
        settings: the resolved config.
        training: conf/training.
    """
    notes = []
    difference = None
    if not is_imported(settings["data"]):
        difference = first_difference(dict(manifest.spec), DatasetSpec.from_dict(settings["data"]).to_dict())
    if difference is not None:
        notes.append(f"{directory} was not made from these data settings ({difference}), so training would refuse it.")
    number = len(manifest.splits["train"])
    if training.num_train is not None and training.num_train > number:
        notes.append(f"training.num_train is {training.num_train}, but the set has {number} training trajectories.")
    return notes


def machine_memory() -> float:
    """Return the memory of this machine [bytes]."""
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def _of_data(manifest: Manifest, model: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "dim": manifest.dim,
        "dt": manifest.dt,
        "spacing": manifest.spacing,
        "particle_types": manifest.particle_types,
        "material_features": choose_features(model["material_features"], manifest.material_features),
    }
