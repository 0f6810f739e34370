"""Checkpoints of ours with the features of geoelements/gns become its weights, model-N.pt with metadata.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gns_pl.checkpoint import load_checkpoint
from gns_pl.errors import InputError
from gns_pl.frame_simulator import FrameConfig, FrameSimulator
from gns_pl.io import atomic_path
from gns_pl.io.atomic import write_atomically
from gns_pl.io.convert import geoelements_weights as theirs
from gns_pl.io.convert.metadata import NAME


def noise_of(provenance: Mapping[str, Any]) -> float:
    """Return the noise in a checkpoint's standard deviations [m]: of the weights, or of a training of ours."""
    if "weights" in provenance:
        return float(provenance["weights"]["noise_std"])
    return float(provenance.get("config", {}).get("training", {}).get("noise_std", 0.0))


def export_weights(source: Path, target: Path) -> Path:
    """Write a checkpoint as geoelements/gns has it: `target` and metadata.json beside it, in metres and our axes.

    Args:
        source: checkpoint of ours.
        target: model-N.pt.

    Raises:
        InputError: a checkpoint whose features theirs do not have, or a target that is there.
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
            raise InputError(f"{path}: is there already; remove it or choose another folder for target=.")
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
        "dt": config.dt,
        "boundary_augment": config.boundary_clip,
        "nnode_in": simulator.node_width(),
        "nedge_in": config.dim + 1,
        "sequence_length": config.input_sequence_length,
        "noise_std": noise,
    }
    for key, name in (("vel", "velocity"), ("acc", "acceleration")):
        std = getattr(simulator, f"{name}_std").double().numpy()
        metadata[f"{key}_mean"] = getattr(simulator, f"{name}_mean").double().tolist()
        metadata[f"{key}_std"] = np.sqrt(np.maximum(std**2 - noise**2, 0.0)).tolist()
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(target) as temporary:
        torch.save({name: value.detach() for name, value in weights.items()}, temporary)
    write_atomically(target.parent / NAME, (json.dumps(metadata, indent=1) + "\n").encode())
    return target
