"""Checkpoints of ours with the features of geoelements/gns become its weights, model-N.pt with metadata.json.

Its program builds the network and its normalisation from the metadata.json of the data folder, so that this file says
everything that the weights were trained with: the statistics digit for digit, and box and length of the trajectories.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gns_pl.convert.common import Common
from gns_pl.convert.exports import with_parts
from gns_pl.convert.formats import geoelements_weights as theirs
from gns_pl.convert.formats.metadata import NAME, PART_OF_SPLIT, frame_statistics, stated_of
from gns_pl.errors import InputError
from gns_pl.generation import DatasetSpec, chosen_every, is_imported
from gns_pl.generation.records import stored_folders
from gns_pl.io import MANIFEST_NAME, atomic_path, manifest_sha256, read_header, read_manifest
from gns_pl.io.atomic import write_atomically
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint
from gns_pl.models.geoelements import FrameConfig, FrameSimulator

BUILT = {
    "input_sequence_length": 6,
    "latent_size": 128,
    "num_mlp_layers": 2,
    "num_message_passing_steps": 10,
    "num_types": 9,
    "type_size": 16,
}
"""What is written in the program of geoelements/gns itself, and in no file."""
NOISE = 6.7e-4
"""Noise that it takes by itself, which is in its standard deviations."""


def noise_of(provenance: Mapping[str, Any]) -> float:
    """Return the noise in a checkpoint's standard deviations [m]: of the weights, or of a training of ours."""
    if "weights" in provenance:
        return float(provenance["weights"]["noise_std"])
    return float(provenance.get("config", {}).get("training", {}).get("noise_std", 0.0))


def export_weights(
    source: Path,
    target: Path,
    *,
    data: str | None = None,
    lower: Sequence[float] | None = None,
    upper: Sequence[float] | None = None,
) -> Path:
    """Write a checkpoint as geoelements/gns has it: `target` and metadata.json beside it, in metres and our axes.

    Args:
        source: checkpoint of ours.
        target: model-N.pt.
        data: set that says box and length of the trajectories; None takes those that the checkpoint knows.
        lower: lower corner of the box [D] [m]; None takes that of the data.
        upper: upper corner of the box [D] [m].

    Raises:
        InputError: a checkpoint whose features theirs do not have, a target that is there, or data that are not.
    """
    checkpoint = load_checkpoint(source)
    simulator, config = checkpoint.simulator, checkpoint.simulator.config
    if not isinstance(simulator, FrameSimulator) or not isinstance(config, FrameConfig):
        raise InputError(
            f"{source}: does not fit geoelements/gns: its network gives accelerations less gravity, has no edges "
            "from a particle to itself and lets what touches nothing fall freely; only models with their features fit."
        )
    if target.suffix != ".pt":
        raise InputError(f"target={target} must be a file ending in .pt, such as model-0.pt.")
    for path in (target, target.parent / NAME):
        if path.exists():
            raise InputError(f"{path}: exists already; remove it or choose another folder for target=.")
    shape = theirs.Shape(
        dim=config.dim,
        num_velocities=config.input_sequence_length - 1,
        latent_size=config.latent_size,
        num_mlp_layers=config.num_mlp_layers,
        num_message_passing_steps=config.num_message_passing_steps,
        num_types=config.num_types,
        type_size=config.type_size,
        num_material_features=len(config.material_features),
    )
    parameters = dict(simulator.named_parameters())
    weights = theirs.theirs(parameters, shape, doubling=config.edge_update == "legacy_doubling")
    noise = noise_of(checkpoint.provenance)
    metadata: dict[str, Any] = {
        "default_connectivity_radius": config.connectivity_radius,
        "dim": config.dim,
        "boundary_augment": config.boundary_clip,
        "nnode_in": simulator.node_width(),
        "nedge_in": config.dim + 1,
        "noise_std": noise,
        **(_stated_statistics(checkpoint) or _statistics(simulator, noise)),
    }
    metadata = with_parts(metadata, _box_and_length(source, checkpoint, data, lower, upper))
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(target) as temporary:
        torch.save({name: value.detach() for name, value in weights.items()}, temporary)
    write_atomically(target.parent / NAME, (json.dumps(metadata, indent=1) + "\n").encode())
    print(*_hints(target, config, noise), sep="\n")
    return target


def _hints(target: Path, config: FrameConfig, noise: float) -> list[str]:
    """Return what has to be done for their program to step as the checkpoint does, sentence by sentence."""
    lines = [f"Their program reads {NAME} from its data folder: put {target.parent / NAME} there."]
    if noise != NOISE:
        lines.append(
            f"The noise of the training is in the standard deviations: give their program noise_std={noise:g}."
        )
    other = {name: getattr(config, name) for name, value in BUILT.items() if getattr(config, name) != value}
    if other:
        values = ", ".join(f"{name} {value} (there {BUILT[name]})" for name, value in other.items())
        lines.append(f"Warning: their program has these written in it, so change them there: {values}.")
    if config.edge_update == "legacy_doubling":
        lines.append("Warning: only their code from before December 2024 doubles edges as this model does.")
    return lines


def _statistics(simulator: FrameSimulator, noise: float) -> dict[str, list[float]]:
    """Return the statistics that a simulator's buffers hold, the noise taken out of them again."""
    found: dict[str, list[float]] = {}
    for key, name in (("vel", "velocity"), ("acc", "acceleration")):
        std = getattr(simulator, f"{name}_std").double().numpy()
        found[f"{key}_mean"] = getattr(simulator, f"{name}_mean").double().tolist()
        found[f"{key}_std"] = np.sqrt(np.maximum(std**2 - noise**2, 0.0)).tolist()
    return found


def _stated_statistics(checkpoint: Checkpoint) -> dict[str, list[float]] | None:
    """Return the statistics as the data had them, which float32 buffers with noise in them round; None if not stated.

    Those of imported weights are in their metadata, those of a training of ours in the checkpoint or, of one stride, in
    the manifest of its data, as long as this is the same.
    """
    provenance, config = checkpoint.provenance, checkpoint.simulator.config
    weights = provenance.get("weights", {})
    if "axes" in weights:
        moments = frame_statistics(weights["metadata"], config.dim)
        order, scale = list(weights["axes"]), weights["scale"]
        return {key: (value[order] * scale).tolist() for key, value in moments.items()}
    stated: Mapping[str, Any] | None = provenance.get("frame_statistics")
    folder, stride = _data_folder(checkpoint), provenance.get("config", {}).get("training", {}).get("stride")
    if stated is None and folder is not None and (folder / MANIFEST_NAME).is_file() and stride == 1:
        same = manifest_sha256(folder) == provenance.get("manifest_sha256")
        stated = read_manifest(folder).statistics if same else None
    if stated is None:
        return None
    units = {"vel": ("velocity", config.dt), "acc": ("acceleration", config.dt**2)}
    return {
        f"{key}_{moment}": [value * unit for value in stated[name][moment]]
        for key, (name, unit) in units.items()
        for moment in ("mean", "std")
    }


def _box_and_length(
    source: Path,
    checkpoint: Checkpoint,
    data: str | None,
    lower: Sequence[float] | None,
    upper: Sequence[float] | None,
) -> dict[str, Any]:
    """Return "bounds", "dt" and "sequence_length", or these of "train" and "rollout" (`Common.said`).

    Raises:
        InputError: neither the weights' own metadata nor any data say them, or a box that is none.
    """
    config, weights = checkpoint.simulator.config, checkpoint.provenance.get("weights", {})
    if (lower is None) != (upper is None):
        raise InputError("lower= and upper= belong together: give both corners of the box, in metres.")
    box = (
        None if lower is None or upper is None else [list(map(float, pair)) for pair in zip(lower, upper, strict=False)]
    )
    if box is not None and (len(box) != config.dim or any(low >= high for low, high in box)):
        raise InputError(f"a box from {list(lower or ())} to {list(upper or ())} does not fit {config.dim} dimensions.")
    if data is None and "axes" in weights:
        stated = stated_of(weights["metadata"], source)
        if stated.lower is not None and stated.upper is not None and box is None:
            corners = [(stated.lower[axis], stated.upper[axis]) for axis in weights["axes"]]
            box = [[value * weights["scale"] for value in pair] for pair in corners]
        length = weights["metadata"].get("sequence_length")
        if box is not None and isinstance(length, int):
            return {"bounds": box, "dt": config.dt, "sequence_length": length}
    folder = _data_folder(checkpoint) if data is None else Path(data)
    if folder is None or not (folder / MANIFEST_NAME).is_file():
        where = "" if folder is None else f" (there is none in {folder})"
        raise InputError(
            f"{source}: does not say in which box its trajectories are and how long; name the data set: "
            f"weights.data=FOLDER{where}"
        )
    return _said(folder, config.dt, box)


def _said(folder: Path, dt: float, box: list[list[float]] | None) -> dict[str, Any]:
    manifest = read_manifest(folder)
    stride = max(1, round(dt / manifest.dt))
    common = Common("geoelements/gns", PART_OF_SPLIT)
    for split, names in manifest.splits.items():
        for name in names:
            header = read_header(folder / name)
            scene = header.scene.replace(origin=())  # a model works near zero, wherever on a map its data were
            try:
                common.see(
                    split,
                    scene,
                    bounds=box,
                    num_frames=(header.num_frames - 1) // stride + 1,
                    num_particles=header.num_particles,
                    dt=dt,
                    num_features=len(header.material_features),
                )
            except InputError as error:
                raise InputError(f"{folder / name}: {error}") from error
    return common.said()


def _data_folder(checkpoint: Checkpoint) -> Path | None:
    """Return where a checkpoint's data were when it was trained; None if it does not say."""
    data = checkpoint.data
    if not data.get("root"):
        return None
    root = Path(data["root"])
    return root if is_imported(data) else stored_folders(root, DatasetSpec.from_dict(data))[chosen_every(data)]
