"""Which of two ways to read weights is right, by the data they were trained on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch_geometric.data import Batch

from gns_pl.data.windows import WindowDataset
from gns_pl.graph import SceneBatch
from gns_pl.io import SPLITS, read_manifest
from gns_pl.models.geoelements import FrameSimulator

WINDOWS = 8
FILES = 2


def compare_edge_updates(simulators: Mapping[str, FrameSimulator], folder: Path) -> str:
    """Return in a sentence how well each way predicts the next frame of a data set, against constant velocities.

    One of them is called the right one only if it predicts better than constant velocities, which need no model.

    Args:
        simulators: way → simulator, of the same weights.
        folder: of the data set.
    """
    manifest = read_manifest(folder)
    names = [name for split in reversed(SPLITS) for name in manifest.splits[split]][:FILES]
    config = next(iter(simulators.values())).config
    windows = WindowDataset(
        [folder / name for name in names],
        input_sequence_length=config.input_sequence_length,
        num_targets=1,
        stride=1,
        start_repeats=1,
        in_memory=False,
    )
    errors = {**dict.fromkeys(simulators, 0.0), "none": 0.0}
    with torch.no_grad():
        # Theirs never sees a window that begins before the first frame.
        whole = [index for index, (_, frame) in enumerate(windows.index) if frame >= windows.before]
        for place in np.unique(np.linspace(0, len(whole) - 1, min(WINDOWS, len(whole))).round().astype(int)).tolist():
            index = whole[place]
            batch = Batch.from_data_list([windows[index]])
            static = SceneBatch(**{key: getattr(batch, key) for key in STATIC}, batch=batch.batch)
            history, truth = batch.position[:, :-1], batch.position[:, -1]
            guesses = {way: simulator.eval()(history, static) for way, simulator in simulators.items()}
            guesses["none"] = 2 * history[:, -1] - history[:, -2]
            for way, guess in guesses.items():
                errors[way] += float((guess - truth)[static.moved].square().mean())
    none = errors.pop("none")
    if not none:
        return f"No whole history in {folder} is followed by a change of velocity, so nothing tells which way is right."
    relative = {way: (error / none) ** 0.5 if math.isfinite(error) else math.inf for way, error in errors.items()}
    told = ", ".join(f"{way} {value:.3g}" for way, value in relative.items())
    told = f"One-step error on {folder}, over that of constant velocities: {told}; "
    best = min(relative, key=lambda way: relative[way])
    if relative[best] < 1:
        return told + f"the right way has the smaller one: weights.edge_update={best}."
    return told + (
        "both are worse than no model at all, so that neither way explains these data. Check that the weights were "
        "trained on such data, in this unit of length (scale=), along these axes (gravity_axis=), with these particle "
        "types and time between frames, and that weights.metadata and weights.noise_std are those of the training."
    )


STATIC = ("particle_type", "material", "volume", "lower", "upper", "gravity")
