"""Models of geoelements/gns become checkpoints of ours that step just as they do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

import gns_pl
from gns_pl.convert.compare import compare_edge_updates
from gns_pl.convert.formats import geoelements_weights as theirs
from gns_pl.convert.formats.metadata import NAME, frame_statistics, part_of, positive, read_json, read_metadata
from gns_pl.convert.formats.source import reading
from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES
from gns_pl.io import file_sha256, manifest_sha256, read_manifest
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.models.geoelements import EDGE_UPDATES, FrameConfig, FrameSimulator, cold_start

UNKNOWN = (
    "weights.edge_update is not given. Code from before December 2024 never updated an edge by its message but doubled "
    "it in each layer, and its weights are silently wrong with any other: say weights.edge_update=residual, or "
    "legacy_doubling for older ones. Taken here: residual."
)


@dataclass(frozen=True)
class Frame:
    """In which units and along which axes a model of theirs is brought.

    Attributes:
        dt: time of one frame [s].
        spacing: of the particles [m].
        scale: metres in their unit of length.
        axes: of theirs, in the order of ours.
    """

    dt: float
    spacing: float
    scale: float
    axes: tuple[int, ...]


def inspect_weights(source: Path, metadata: str | None = None) -> list[str]:
    """Return what weights are, line by line.

    Args:
        source: model-N.pt.
        metadata: metadata.json of the data; None looks beside the weights.

    Raises:
        InputError: files that cannot be used.
    """
    weights = theirs.read_weights(source)
    with reading(source):
        shape = theirs.shape_of(weights)
    stated = _metadata(source, metadata)
    needed = ("default_connectivity_radius", "dt", "vel_mean", "vel_std", "acc_mean", "acc_std")
    missing = [key for key in needed if key not in stated]
    count = sum(value.numel() for value in weights.values())
    return [
        f"{source}: weights of geoelements/gns, {count:,} parameters",
        f"  {shape.dim} dimensions, {shape.num_velocities} velocities, {shape.num_types} types in {shape.type_size} "
        f"numbers, {shape.num_material_features or 'no'} material value",
        f"  {shape.num_message_passing_steps} message-passing steps, states of {shape.latent_size}, "
        f"{shape.num_mlp_layers} hidden layers",
        f"  metadata: {', '.join(sorted(stated)) or 'none beside the weights; name them: weights.metadata=…'}",
        *(f"  missing: {key} in {NAME}" for key in missing if stated),
    ]


def _metadata(source: Path, metadata: str | None) -> dict[str, Any]:
    """Return the metadata of the training, by which the weights are normalised."""
    return read_metadata(source.parent) if metadata is None else part_of(read_json(Path(metadata)), "train")


def import_weights(
    source: Path,
    target: Path,
    *,
    edge_update: str | None,
    noise_std: float,
    metadata: str | None = None,
    data: str | None = None,
    description: str = "",
    scale: float | None = None,
    gravity_axis: str | int | None = None,
    spacing: float | None = None,
    dt: float | None = None,
    name: str | None = None,
) -> Path:
    """Write a checkpoint that steps as weights of geoelements/gns do.

    Args:
        source: model-N.pt.
        target: checkpoint to write.
        edge_update: "residual" or "legacy_doubling"; None takes the first, with a warning.
        noise_std: of their training, in their unit of length; it is in their standard deviations.
        metadata: metadata.json of their data; None looks beside the weights.
        data: an imported data set; its units, axes and spacing are taken, and the checkpoint is judged on it.
        description: kept in the checkpoint.
        scale: metres in their unit of length; None takes that of `data`, else 1.
        gravity_axis: their vertical axis; None takes that of `data`, else the last.
        spacing: of the particles, in their unit; None takes that of `data`.
        dt: time of one frame [s]; None takes that of the metadata.
        name: of the data, without `data`.

    Returns:
        The checkpoint.

    Raises:
        InputError: files that cannot be used, or something that neither says.
    """
    if edge_update is not None and edge_update not in EDGE_UPDATES:
        raise InputError(f"weights.edge_update must be one of {', '.join(EDGE_UPDATES)}, not {edge_update!r}.")
    if isinstance(noise_std, bool) or not isinstance(noise_std, int | float) or not 0 <= noise_std < math.inf:
        raise InputError(f"weights.noise_std must be a number that is not negative, not {noise_std!r}.")
    if target.exists():
        raise InputError(f"{target}: exists already; remove it or choose another target=.")
    weights, stated = theirs.read_weights(source), _metadata(source, metadata)
    with reading(source):
        shape = theirs.shape_of(weights)
    frame = _frame(stated, shape, data, scale=scale, gravity_axis=gravity_axis, spacing=spacing, dt=dt)
    simulators = {}
    for kind in EDGE_UPDATES:
        with reading(source):
            simulators[kind] = build(weights, shape, stated, frame, noise_std=noise_std, edge_update=kind)
    if edge_update is None:
        print(f"Warning: {UNKNOWN}")
    if data is not None:
        print(compare_edge_updates(simulators, Path(data)))
    spec: dict[str, Any] = {"name": name or source.stem}
    if data is not None:
        spec = {**read_manifest(data).spec, "root": data}
    provenance = {
        "description": description,
        "steps": _steps(source),
        "versions": {"gns_pl": gns_pl.__version__},
        "weights": {
            "format": "geoelements/gns",
            "file": source.name,
            "sha256": file_sha256(source),
            "edge_update": edge_update or "unknown, taken for residual",
            "noise_std": noise_std * frame.scale,
            "scale": frame.scale,
            "axes": list(frame.axes),
            "metadata": stated,
        },
    }
    if data is not None:
        provenance["manifest_sha256"] = manifest_sha256(data)
    target.parent.mkdir(parents=True, exist_ok=True)
    simulator = simulators[edge_update or EDGE_UPDATES[0]].eval()
    save_checkpoint(target, Checkpoint(simulator, spec, provenance))
    print(cold_start(simulator.config, provenance))
    return target


def _steps(source: Path) -> int:
    number = source.stem.rpartition("-")[2]
    return int(number) if number.isdigit() else 0


def _frame(
    stated: Mapping[str, Any],
    shape: theirs.Shape,
    data: str | None,
    *,
    scale: float | None,
    gravity_axis: str | int | None,
    spacing: float | None,
    dt: float | None,
) -> Frame:
    from gns_pl.convert.facts import turned_axes
    from gns_pl.convert.given import axis_number

    axes, metres = tuple(range(shape.dim)), None
    if data is not None:
        manifest = read_manifest(data)
        imported: Mapping[str, Any] = manifest.spec.get("imported", {})
        if manifest.dim != shape.dim:
            raise InputError(f"{data}: has {manifest.dim} dimensions, the weights {shape.dim}.")
        scale = imported.get("scale", 1.0) if scale is None else scale
        axes = tuple(imported.get("axes", axes))
        metres, dt = manifest.spacing, manifest.dt if dt is None else dt
    scale = 1.0 if scale is None else scale
    if gravity_axis is not None:
        axes = turned_axes(axis_number(gravity_axis, shape.dim), shape.dim)
    dt = positive(stated, "dt") if dt is None else dt
    if spacing is not None:
        metres = spacing * scale
    if dt is None:
        raise InputError("the weights do not say how long a frame is: give dt=0.0025, in seconds.")
    if metres is None:
        raise InputError("the weights do not say how far particles are apart: give spacing=…, or weights.data=FOLDER.")
    return Frame(float(dt), float(metres), float(scale), axes)


def build(
    weights: Mapping[str, torch.Tensor],
    shape: theirs.Shape,
    stated: Mapping[str, Any],
    frame: Frame,
    *,
    noise_std: float,
    edge_update: str,
) -> FrameSimulator:
    """Return the simulator of weights.

    Args:
        weights: theirs.
        shape: of them.
        stated: their metadata: connectivity radius, statistics of frames, boundary_augment.
        frame: units and axes.
        noise_std: of their training, in their unit of length.
        edge_update: as `FrameConfig`.

    Raises:
        InputError: metadata that lack something, or layers that do not fit; the caller names the file.
    """
    radius = positive(stated, "default_connectivity_radius")
    if radius is None:
        raise InputError(f"{NAME} lacks default_connectivity_radius; name it: weights.metadata=FILE")
    doubling = edge_update == "legacy_doubling"
    config = FrameConfig(
        dim=shape.dim,
        dt=frame.dt,
        spacing=frame.spacing,
        particle_types=tuple(range(shape.num_types)),
        material_features=MATERIAL_FEATURES[: shape.num_material_features],
        connectivity_radius=radius * frame.scale,
        input_sequence_length=shape.num_velocities + 1,
        latent_size=shape.latent_size,
        num_mlp_layers=shape.num_mlp_layers,
        num_message_passing_steps=shape.num_message_passing_steps,
        output="acceleration",
        context=False,
        neighbours="auto",
        num_types=shape.num_types,
        type_size=shape.type_size,
        boundary_clip=positive(stated, "boundary_augment") or 1.0,
        edge_update=edge_update,
    )
    simulator = FrameSimulator(config)
    try:
        parameters = theirs.ours(weights, shape, doubling=doubling, axes=frame.axes)
        simulator.load_state_dict({**simulator.state_dict(), **parameters})
    except RuntimeError as error:
        raise InputError("has layers whose shapes do not fit each other.") from error
    moments, order = frame_statistics(stated, shape.dim), list(frame.axes)
    for key, name in (("vel", "velocity"), ("acc", "acceleration")):
        std = np.sqrt(moments[f"{key}_std"] ** 2 + noise_std**2)
        if not (std > 0).all():
            raise InputError(f"{key}_std must be positive along every axis.")
        getattr(simulator, f"{name}_mean").copy_(torch.from_numpy(moments[f"{key}_mean"][order] * frame.scale))
        getattr(simulator, f"{name}_std").copy_(torch.from_numpy(std[order] * frame.scale))
    return simulator
