"""What a network sees in training, measured: at the start of a training, or for a checkpoint that does not say yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch_geometric.data import Batch

from gns_pl.data.windows import WindowDataset
from gns_pl.errors import InputError
from gns_pl.graph import TrainingDistribution, WindowRandom
from gns_pl.io import manifest_sha256, read_manifest
from gns_pl.models.checkpoint import load_checkpoint, save_checkpoint
from gns_pl.models.simulator import Simulator
from gns_pl.training.module import static_of_batch
from gns_pl.training.symmetry import sample_symmetry

WINDOWS, PARTICLES = 400, 100_000
"""So many windows are looked at, or as many as have so many particles."""


def measure_distribution(
    simulator: Simulator, windows: WindowDataset, *, symmetry: bool, seed: int, source: str = ""
) -> TrainingDistribution:
    """Summarise the states of random windows, without noise; nothing else draws from these random numbers.

    Args:
        simulator: with the statistics of the data; its weights are not used.
        windows: the training set, each window as often in it as it is shown.
        symmetry: scenes are mirrored at random, as in the training.
        seed: of the windows.
        source: hash of the manifest of the data.
    """
    states, left, length = [], PARTICLES, simulator.config.input_sequence_length
    with torch.no_grad():
        for number, index in enumerate(np.random.default_rng(seed).integers(len(windows), size=WINDOWS).tolist()):
            batch = Batch.from_data_list([windows[index, number]])
            position, static = batch.position, static_of_batch(batch)
            if symmetry:
                position, static = sample_symmetry(position, static, WindowRandom(seed, batch.number, static.batch))
            states.append(simulator.state(position[:, :length], static)[static.moved])
            left -= len(states[-1])
            if left <= 0:
                break
    return TrainingDistribution.of(torch.cat(states), simulator.state_names(), source)


def add_distribution(path: str | Path, directory: Path, out: Path) -> str | None:
    """Write a checkpoint again with what its network saw; weights, config and provenance stay as they are.

    Args:
        path: the checkpoint, or the name of one that comes with the package.
        directory: folder of its data set, with the manifest.
        out: file to write, may be the same.

    Returns:
        What is to be known of it, in a sentence: that the data are not those of the training to the last bit. Or None.

    Raises:
        InputError: no such file, a checkpoint that does not say how it was trained, or data that do not fit it.
    """
    checkpoint, manifest = load_checkpoint(path), read_manifest(directory)
    config, provenance = checkpoint.simulator.config, checkpoint.provenance
    training: Mapping[str, Any] | None = provenance.get("config", {}).get("training")
    if training is None:
        raise InputError(f"{path}: does not say how it was trained, so what it saw cannot be measured.")
    fits = manifest.dim == config.dim and np.isclose(manifest.spacing, config.spacing, rtol=1e-6)
    if not fits or not np.isclose(manifest.dt * training["stride"], config.dt):
        raise InputError(f"{directory}: has another dimension, spacing or interval than {path}; name its own data.")
    windows = WindowDataset(
        [directory / name for name in manifest.splits["train"][: training["num_train"]]],
        input_sequence_length=config.input_sequence_length,
        num_targets=1,
        stride=training["stride"],
        start_repeats=training["start_repeats"],
        moving_repeats=training["moving_repeats"],
        in_memory=False,
        cell=config.spacing if config.sees_surfaces else None,
    )
    source, symmetry = manifest_sha256(directory), training["optimisation"]["symmetry"]
    seed = int(provenance["config"].get("seed", 0))
    distribution = measure_distribution(checkpoint.simulator, windows, symmetry=symmetry, seed=seed, source=source)
    save_checkpoint(out, replace(checkpoint, distribution=distribution))
    if source == provenance.get("manifest_sha256"):
        return None
    return f"{directory}: was made anew since {path} was trained; what it saw is measured on the set as it is now."
