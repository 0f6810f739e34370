"""Weights of geoelements/gns, `model-N.pt`: their names and shapes, and the same numbers under the names of ours.

A state_dict: MLPs of Linear layers NN-0, NN-1, … with a LayerNorm behind all but the decoder's, a table of particle
types, and unshared interaction networks. The first layer of an edge's MLP takes [receiver, sender, edge], which ours
has in three parts; that of a node takes [sum of messages, node], as ours does. Tensors in, tensors out.
"""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from gns_pl.errors import InputError

ROOT = "_encode_process_decode."
TYPES = "_particle_type_embedding.weight"
_LAYER = re.compile(re.escape(ROOT) + r"_processor\.gnn_stacks\.(\d+)\.")


@dataclass(frozen=True)
class Shape:
    """What the shapes of weights tell.

    Attributes:
        dim: D.
        num_velocities: H − 1.
        latent_size: width of the states.
        num_mlp_layers: hidden layers of each MLP.
        num_message_passing_steps: interaction networks.
        num_types: rows of the table of types.
        type_size: its width.
        num_material_features: 0 or 1.
    """

    dim: int
    num_velocities: int
    latent_size: int
    num_mlp_layers: int
    num_message_passing_steps: int
    num_types: int
    type_size: int
    num_material_features: int


def read_weights(path: Path) -> dict[str, Tensor]:
    """Return a state_dict, without running anything that stands in the file.

    Raises:
        InputError: no such file, or not weights of geoelements/gns; the file is named.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, zipfile.BadZipFile, RuntimeError, EOFError, OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: holds no plain weights, or is cut off; save a state_dict by torch.save.") from error
    if isinstance(content, Mapping) and not any(isinstance(value, Tensor) for value in content.values()):
        content = next((value for key, value in content.items() if "state_dict" in str(key)), content)
    if not isinstance(content, Mapping) or not all(isinstance(value, Tensor) for value in content.values()):
        raise InputError(f"{path}: is no state_dict, names and tensors.")
    weights = {str(name).removeprefix("module."): value for name, value in content.items()}
    if TYPES not in weights or f"{ROOT}_decoder.node_fn.NN-0.weight" not in weights:
        raise InputError(f"{path}: are not weights of geoelements/gns (they lack {TYPES} or {ROOT}…).")
    for name, value in weights.items():
        if not torch.is_floating_point(value) or not bool(torch.isfinite(value).all()):
            raise InputError(f"{path}: {name} holds numbers that are not finite.")
    return weights


def shape_of(weights: Mapping[str, Tensor]) -> Shape:
    """Return what the shapes tell.

    Raises:
        InputError: shapes that fit no network of theirs; the caller names the file.
    """
    try:
        layers = 1 + max(int(match[1]) for match in map(_LAYER.match, weights) if match)
        hidden = sum(name.startswith(f"{ROOT}_decoder.node_fn.NN-") for name in weights) // 2 - 1
        dim, latent = weights[f"{ROOT}_decoder.node_fn.NN-{hidden}.weight"].shape
        num_types, type_size = weights[TYPES].shape
        node = weights[f"{ROOT}_encoder.node_fn.0.NN-0.weight"].shape[1]
        edge = weights[f"{ROOT}_encoder.edge_fn.0.NN-0.weight"].shape[1]
    except (KeyError, ValueError, IndexError) as error:
        raise InputError("lacks layers that networks of geoelements/gns have.") from error
    num_velocities, material = divmod(node - 2 * dim - type_size, dim)
    if edge != dim + 1 or dim not in (2, 3) or num_velocities < 1 or material > 1:
        raise InputError(
            f"has {node} node and {edge} edge features for {dim} dimensions; known are velocities, {2 * dim} distances "
            f"to walls, {type_size} of the type and at most one of the material, and {dim + 1} of an edge."
        )
    return Shape(dim, num_velocities, latent, hidden, layers, num_types, type_size, material)


def _pairs(shape: Shape) -> Iterator[tuple[str, str, bool]]:
    """Yield their MLP, ours, and whether a LayerNorm is behind it."""
    yield f"{ROOT}_encoder.node_fn", "network.node_encoder", True
    yield f"{ROOT}_encoder.edge_fn", "network.edge_encoder", True
    yield f"{ROOT}_decoder.node_fn", "network.decoder", False
    for layer in range(shape.num_message_passing_steps):
        for kind in ("edge", "node"):
            theirs = f"{ROOT}_processor.gnn_stacks.{layer}.{kind}_fn"
            yield theirs, f"network.processor.{layer}.{kind}_mlp", True


def names(shape: Shape) -> Iterator[tuple[str, str]]:
    """Yield every name of theirs and that of ours, apart from the first layer of edges, which `ours` splits."""
    yield TYPES, "types.weight"
    for theirs, ours, norm in _pairs(shape):
        inner = f"{theirs}.0" if norm else theirs
        for place in range(shape.num_mlp_layers + 1):
            for kind in ("weight", "bias"):
                yield f"{inner}.NN-{place}.{kind}", f"{ours}.{2 * place}.{kind}"
        if norm:
            for kind in ("weight", "bias"):
                yield f"{theirs}.1.{kind}", f"{ours}.{2 * shape.num_mlp_layers + 1}.{kind}"


def _edge_layers(shape: Shape) -> Iterator[tuple[int, str]]:
    for layer in range(shape.num_message_passing_steps):
        yield layer, f"network.processor.{layer}"


def ours(weights: Mapping[str, Tensor], shape: Shape, *, doubling: bool, axes: tuple[int, ...]) -> dict[str, Tensor]:
    """Return the parameters of a `FrameSimulator`.

    Args:
        weights: theirs.
        shape: of them.
        doubling: edges double in every layer, so that layer k gets 2^k in its weights of the edge.
        axes: of theirs, in the order of ours.

    Raises:
        InputError: a layer is missing, is left over, or has another shape; the caller names the file.
    """
    table = dict(names(shape))
    missing, left = sorted(set(table) - set(weights)), sorted(set(weights) - set(table))
    if missing or left:
        raise InputError(f"lacks {missing[0]}." if missing else f"has {left[0]}, which their networks do not have.")
    parameters = {table[name]: value.float().clone() for name, value in weights.items()}
    width = shape.latent_size
    for layer, place in _edge_layers(shape):
        whole = parameters[f"{place}.edge_mlp.0.weight"]
        if whole.shape != (width, 3 * width):
            raise InputError(f"layer {layer} has a first matrix of {tuple(whole.shape)}, not {(width, 3 * width)}.")
        parameters[f"{place}.receiver.weight"], parameters[f"{place}.sender.weight"], edge = torch.split(
            whole, width, dim=1
        )
        parameters[f"{place}.edge_mlp.0.weight"] = edge * (2.0**layer if doubling else 1.0)
    return turned(parameters, shape, axes)


def theirs(parameters: Mapping[str, Tensor], shape: Shape, *, doubling: bool) -> dict[str, Tensor]:
    """Return the state_dict of theirs that steps as parameters of a `FrameSimulator` do; the inverse of `ours`.

    Args:
        parameters: ours.
        shape: of them.
        doubling: as of `ours`.
    """
    theirs = dict(parameters)
    for layer, place in _edge_layers(shape):
        edge = theirs[f"{place}.edge_mlp.0.weight"] / (2.0**layer if doubling else 1.0)
        parts = [theirs.pop(f"{place}.receiver.weight"), theirs.pop(f"{place}.sender.weight"), edge]
        theirs[f"{place}.edge_mlp.0.weight"] = torch.cat(parts, dim=1)
    return {name: theirs[other].clone() for name, other in names(shape)}


def turned(parameters: Mapping[str, Tensor], shape: Shape, axes: tuple[int, ...]) -> dict[str, Tensor]:
    """Return the parameters for vectors along other axes.

    Args:
        parameters: ours.
        shape: of them.
        axes: of the old, in the order of the new.
    """
    dim, permuted = shape.dim, dict(parameters)
    order = torch.tensor(axes)
    vectors = shape.num_velocities + 2  # and distances to the lower and the upper walls
    columns = torch.cat([dim * block + order for block in range(vectors)])
    for name, places in (("node_encoder", columns), ("edge_encoder", order)):
        weight = permuted[f"network.{name}.0.weight"].clone()
        weight[:, : len(places)] = weight[:, places]
        permuted[f"network.{name}.0.weight"] = weight
    last = 2 * shape.num_mlp_layers
    for kind in ("weight", "bias"):
        permuted[f"network.decoder.{last}.{kind}"] = permuted[f"network.decoder.{last}.{kind}"][order]
    return permuted
