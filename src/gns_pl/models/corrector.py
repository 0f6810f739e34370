"""What a coarse material point run misses, learned: after some of its steps, by which velocity its points are too slow.

Density, walls, free fall and rest come from the material point method; the network adds a velocity to points that move.
It sees the same graph and features as a `Simulator`, but of the places to which the coarse run has brought the points,
and besides what that run did to their velocities. `solvers.correction` runs the two together, `training.correction`
fits it to fine runs. A file holds config, weights, data and provenance, and no code.
"""

from __future__ import annotations

import dataclasses
import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES
from gns_pl.graph import SceneBatch, edge_features, edge_width, node_features, node_width, radius_graph
from gns_pl.graph.radius import advised_radius
from gns_pl.io import atomic_path
from gns_pl.models.checkpoint import KEY as CHECKPOINT_KEY
from gns_pl.models.shipped import CORRECTOR_KIND
from gns_pl.nn import EncodeProcessDecode, in_float32

KEY = "gns_pl_corrector"
FORMAT_VERSION = 1

STILL = 0.1
"""Of the velocity threshold: what is slower gets no correction at all, where corrections are bounded."""

TINY = 1e-12
"""Square of a speed [m²/s²] below which its derivative is cut off."""

PREFIX = "corrector."
"""Of its weights in the checkpoints of a training."""

RENAMED = {"slow": "velocity_threshold"}
"""Keys of a config in files of before → their names now."""


@dataclass(frozen=True)
class CorrectorConfig:
    """Everything that rebuilds a `Corrector` but its weights and scales.

    Attributes:
        dim: D, 2 or 3.
        interval: time between corrections [s].
        spacing: of the points [m].
        mpm: settings of the coarse run, as `MPMConfig`.
        connectivity_radius: R [m].
        latent_size: width of the states.
        num_mlp_layers: hidden layers of each MLP.
        num_message_passing_steps: number of interaction networks.
        velocity_threshold: share of the velocity scale; the correction of a point of this speed is halved, and it
            vanishes with the speed: what rests is left alone.
        coarse: {"cells", "factors"} of a coarse run of its own points, its cells √(L0 H0) over "cells" and its scalars
            retuned (`solvers.retuned`); spacing and radius are then in spacings of these points, and `mpm` has no cell
            size. None: a run on cells of one size, with the points of the data.
        largest: bound of a correction, in tan φ g Δt, what friction takes from a sliding point until the next one; such
            a correction is along a point's own horizontal motion, or against it. None for a vector without a bound.

    Raises:
        InputError: a value out of range.
    """

    dim: int
    interval: float
    spacing: float
    mpm: Mapping[str, Any]
    connectivity_radius: float
    latent_size: int
    num_mlp_layers: int
    num_message_passing_steps: int
    velocity_threshold: float
    coarse: Mapping[str, Any] | None = None
    largest: float | None = None

    def __post_init__(self) -> None:
        for name in ("interval", "spacing", "connectivity_radius", "velocity_threshold", "largest"):
            if getattr(self, name) is not None and not getattr(self, name) > 0:
                raise InputError(f"model.{name} must be positive, not {getattr(self, name)}.")
        if self.connectivity_radius < self.spacing:
            raise InputError(
                f"model.connectivity_radius = {self.connectivity_radius:g} m reaches no neighbour at a spacing of "
                f"{self.spacing:.3g} m; take model.connectivity_radius={advised_radius(self.spacing):g}"
            )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CorrectorConfig:
        """Return the config of a plain mapping, such as conf/model/corrector.yaml with what the data say.

        Raises:
            InputError: an unknown or missing key, or a value out of range.
        """
        fields = dataclasses.fields(cls)
        known, given = {field.name for field in fields}, set(data)
        needed = {field.name for field in fields if field.default is dataclasses.MISSING}
        wrong = [f"unknown key {name}" for name in sorted(given - known)]
        wrong += [f"missing key {name}" for name in sorted(needed - given)]
        if wrong:
            raise InputError(f"model: {', '.join(wrong)}; known are {', '.join(sorted(known))}.")
        return cls(**data)


class Corrector(nn.Module):
    """The velocity that every point of a coarse run is short of.

    Args:
        config: its shape.

    Attributes:
        velocity_scale: root mean square of a velocity component [] [m/s].
        correction_scale: the same of what the coarse run misses [] [m/s]; of no account where corrections are bounded.
    """

    velocity_scale: Tensor
    correction_scale: Tensor

    @in_float32
    def __init__(self, config: CorrectorConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("velocity_scale", torch.ones(()))
        self.register_buffer("correction_scale", torch.ones(()))
        width = node_width(
            dim=config.dim, input_sequence_length=2, num_particle_types=1, num_material_features=0, context=True
        )
        self.network = EncodeProcessDecode(
            node_width=width + config.dim,
            edge_width=edge_width(config.dim),
            output_width=config.dim if config.largest is None else 1,
            latent_size=config.latent_size,
            num_mlp_layers=config.num_mlp_layers,
            num_message_passing_steps=config.num_message_passing_steps,
        )
        if config.coarse is not None:  # an untrained one leaves the coarse run as it is
            last = cast(nn.Linear, self.network.decoder[-1])
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(
        self, before: Tensor, position: Tensor, predicted: Tensor, static: SceneBatch, unit: float = 1.0
    ) -> Tensor:
        """Return the velocities to add [N, D] [m/s].

        Args:
            before: positions one interval before [N, D] [m].
            position: positions from which the coarse run went on [N, D] [m].
            predicted: where it has brought the points [N, D] [m].
            static: the scenes.
            unit: of `config.spacing` and `config.connectivity_radius` [m].
        """
        config, dtype = self.config, self.velocity_scale.dtype
        radius, spacing = config.connectivity_radius * unit, config.spacing * unit
        before, position, predicted = (each.to(dtype) for each in (before, position, predicted))
        static = static.in_precision(dtype)
        velocity = (predicted - position) / config.interval
        threshold = config.velocity_threshold * self.velocity_scale
        if config.largest is None:
            speed = velocity.norm(dim=1, keepdim=True)
        else:
            across = velocity[:, :-1]
            speed = (across.square().sum(dim=1, keepdim=True) + TINY).sqrt()
            direction, speed = across / speed, (speed - STILL * threshold).clamp_min(0)
            if not bool((speed > 0).any()):
                return 0 * predicted  # and a derivative of zero
        edge_index = radius_graph(predicted, radius, static.batch, num_graphs=static.num_graphs)
        node = node_features(
            velocity[:, None],
            predicted,
            static,
            velocity_scale=self.velocity_scale,
            radius=radius,
            spacing=spacing,
            particle_types=(0,),
            material_scale=self.velocity_scale.new_zeros(2, 0),
            context=True,
        )
        change = (predicted - 2 * position + before) / (config.interval * self.velocity_scale)
        edge = edge_features(predicted, edge_index, radius)
        output: Tensor = self.network(torch.cat([node, change], dim=1), edge, edge_index)
        moving: Tensor = speed / (speed + threshold)
        if config.largest is None:
            return output * moving * self.correction_scale
        friction = static.material[:, MATERIAL_FEATURES.index("tan_friction_angle"), None]
        gravity = static.of_particles(static.gravity.norm(dim=1, keepdim=True))
        along = output.tanh() * moving * (config.largest * config.interval * friction * gravity)
        return torch.cat([along * direction, torch.zeros_like(along)], dim=1)


@dataclass(frozen=True)
class CorrectorFile:
    """What a corrector's file holds.

    Attributes:
        corrector: in evaluation mode.
        data: the specification of the data it was trained on, as in conf/data/.
        provenance: versions, steps made, the data's hash.
    """

    corrector: Corrector
    data: dict[str, Any]
    provenance: dict[str, Any]


def save_corrector(path: Path, content: CorrectorFile) -> None:
    """Write a corrector's file, whole or not at all."""
    entry = {
        "format_version": FORMAT_VERSION,
        "config": dataclasses.asdict(content.corrector.config),
        "data": content.data,
        "provenance": content.provenance,
    }
    with atomic_path(path) as temporary:
        torch.save({KEY: entry, "state_dict": content.corrector.state_dict()}, temporary)


def load_corrector(path: Path) -> CorrectorFile:
    """Read a corrector's file, or the checkpoint of a training of one.

    Raises:
        InputError: no such file, or not one of ours.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such corrector.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        entry, weights = content.get(KEY), content["state_dict"]
        if entry is None and content[CHECKPOINT_KEY].get("kind") == CORRECTOR_KIND:
            entry = content[CHECKPOINT_KEY]
            weights = {name.removeprefix(PREFIX): value for name, value in weights.items() if name.startswith(PREFIX)}
        config = {RENAMED.get(name, name): value for name, value in entry["config"].items()}
        corrector = Corrector(CorrectorConfig(**config))
        corrector.load_state_dict(weights)
    except (pickle.UnpicklingError, zipfile.BadZipFile, RuntimeError, EOFError, LookupError, TypeError) as error:
        raise InputError(f"{path}: is not a corrector of gns_pl, or was cut off while written.") from error
    return CorrectorFile(corrector.eval(), entry["data"], entry["provenance"])
