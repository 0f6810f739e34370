"""Which of two ways to read weights is right, by the data they were trained on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch_geometric.data import Batch

from gns_pl.data.windows import WindowDataset
from gns_pl.frame_simulator import FrameSimulator
from gns_pl.graph import Static
from gns_pl.io import SPLITS, read_manifest

WINDOWS = 8
FILES = 2


def compare_edge_updates(simulators: Mapping[str, FrameSimulator], folder: Path) -> str:
    """Return in a sentence how well each way predicts the next frame of a data set, against constant velocities.

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
            static = Static(**{key: getattr(batch, key) for key in STATIC}, batch=batch.batch)
            history, truth = batch.position[:, :-1], batch.position[:, -1]
            guesses = {way: simulator.eval()(history, static) for way, simulator in simulators.items()}
            guesses["none"] = 2 * history[:, -1] - history[:, -2]
            for way, guess in guesses.items():
                errors[way] += float((guess - truth)[static.moved].square().mean())
    relative = {way: (errors[way] / errors["none"]) ** 0.5 if errors["none"] else float("nan") for way in simulators}
    told = ", ".join(f"{way} {value:.3g}" for way, value in relative.items())
    return f"One-step error on {folder}, over that of constant velocities: {told}; the right way has the smaller one."


STATIC = ("particle_type", "material", "volume", "lower", "upper", "gravity")
