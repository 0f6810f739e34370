"""A simulator with the features and the normalisation of geoelements/gns, so that its weights step as they do there.

It steps as `Simulator` does, for rollouts and evaluations alike, and differs in what a network sees and means: lengths
per frame instead of seconds, mean and standard deviation of each axis, a learned code of the particle's type, every
particle its own neighbour, and an acceleration that has gravity in it. Nothing is masked and no wall is hard.

| equation | code |
|---|---|
| ẋ_k = x_k − x_{k−1}, normalised (ẋ − μ_v) / σ_v with σ_v² = σ² + noise² | `features` |
| distances to lower and upper walls / R, cut to ± `boundary_clip` | `features` |
| x_{t+1} = x_t + ẋ_t + σ_a y + μ_a, y of the network | `integrate` |
| e ← e + m (residual), or e ← 2 e in each layer (legacy_doubling) | `FrameConfig.edge_update` |

In the second way of updating an edge, layer k sees 2^k times the encoded edge. Powers of two scale floating-point
numbers exactly, so that such networks are those of static edges with 2^k in the weights of layer k.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, edge_features, radius_graph
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.simulator import Evaluation, Search, Simulator
from gns_pl.nn import DEFAULT_NETWORK, EncodeProcessDecode, in_float32

EDGE_UPDATES = ("residual", "legacy_doubling")


@dataclass(frozen=True)
class FrameConfig(SimulatorConfig):
    """Everything that rebuilds a `FrameSimulator` but its weights and statistics.

    Attributes:
        num_types: rows of the table of types, from type 0 on.
        type_size: width of a type's code.
        boundary_clip: distances to walls are cut at so many radii.
        edge_update: "residual": an edge is updated by its message. "legacy_doubling": it doubles in every layer.

    Raises:
        InputError: values that make no such simulator.
    """

    exact_steps: ClassVar[bool] = True
    self_loops: ClassVar[bool] = True

    num_types: int = 9
    type_size: int = 16
    boundary_clip: float = 1.0
    edge_update: str = "residual"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.edge_update not in EDGE_UPDATES:
            raise InputError(f"edge_update must be one of {', '.join(EDGE_UPDATES)}, not {self.edge_update!r}.")
        if self.output != "acceleration" or self.context or self.network != DEFAULT_NETWORK or self.walls != "box":
            raise InputError("a simulator in frames has output=acceleration, walls=box, its own network, no context.")
        if max(self.particle_types, default=0) >= self.num_types or min(self.particle_types, default=0) < 0:
            raise InputError(f"particle types {list(self.particle_types)} need more than num_types={self.num_types}.")


class FrameSimulator(Simulator):
    """One step in units of one frame, learned as by geoelements/gns.

    The statistics are persistent buffers [D], in metres per frame and per frame squared: `velocity_mean`,
    `velocity_std`, `acceleration_mean`, `acceleration_std`, the noise of the training in them.

    Args:
        config: its shape.
    """

    config_class: ClassVar[type[SimulatorConfig]] = FrameConfig

    velocity_mean: Tensor
    velocity_std: Tensor
    acceleration_mean: Tensor
    acceleration_std: Tensor
    config: FrameConfig

    @in_float32
    def __init__(self, config: FrameConfig) -> None:
        super().__init__(config)
        # Doubled edges are the encoded ones with powers of two in the weights (`convert.formats.geoelements_weights`).
        assert isinstance(self.network, EncodeProcessDecode)
        self.network.static_edges = config.edge_update == "legacy_doubling"
        self.types = nn.Embedding(config.num_types, config.type_size)
        for name in ("velocity", "acceleration"):
            self.register_buffer(f"{name}_mean", torch.zeros(config.dim))
            self.register_buffer(f"{name}_std", torch.ones(config.dim))

    def fit_statistics(self, moments: Mapping[str, Any], *, gravity: float, noise_std: float, material: Tensor) -> None:
        """Set the normalisation from that of a data set, per axis; gravity stays in the accelerations.

        Args:
            moments: "velocity" [m/s] and "acceleration" [m/s²] → "mean" and "std" per axis [D].
            gravity: not used.
            noise_std: of the latest displacement's noise, in the training [m].
            material: not used; material values go in as they are.

        Raises:
            InputError: an axis along which nothing moves.
        """
        dt = self.config.dt
        for name, unit in (("velocity", dt), ("acceleration", dt**2)):
            mean, std = (torch.tensor(moments[name][key], dtype=torch.float64) * unit for key in ("mean", "std"))
            std = (std.square() + noise_std**2).sqrt()
            if not bool((std > 0).all()):
                raise InputError(f"the {name} statistics of the data are zero along an axis; give training.noise_std.")
            getattr(self, f"{name}_mean").copy_(mean)
            getattr(self, f"{name}_std").copy_(std)

    def node_width(self) -> int:
        """Return the width of the node features."""
        config = self.config
        width = (config.input_sequence_length + 1) * config.dim
        return width + config.type_size + len(config.material_features)

    def features(self, history: Tensor, scenes: SceneBatch, search: Search | None = None) -> tuple[Tensor, Tensor]:
        """Return what every particle knows of itself [N, F], and the edges [2, E], also from each to itself.

        Args:
            history: positions of the last H frames, the latest last [N, H, D] [m].
            scenes: those that are stepped.
            search: as of `Simulator.features`.
        """
        config, position = self.config, history[:, -1]
        edge_index = (search or radius_graph)(
            position,
            config.connectivity_radius,
            scenes.batch,
            backend=config.neighbours,
            num_graphs=scenes.num_graphs,
        )
        velocity = (history.diff(dim=1) - self.velocity_mean) / self.velocity_std
        lower, upper = scenes.of_particles(scenes.lower), scenes.of_particles(scenes.upper)
        walls = torch.cat([position - lower, upper - position], dim=1) / config.connectivity_radius
        clip = config.boundary_clip
        parts = [velocity.flatten(1), walls.clamp(-clip, clip), self.types(scenes.particle_type)]
        if config.material_features:
            parts.append(scenes.material[:, : len(config.material_features)])
        return torch.cat(parts, dim=1), with_self_loops(edge_index, len(position))

    def state_names(self) -> list[str]:
        """Return in a word what each column of `state` is about."""
        config = self.config
        names = ["velocity"] * (config.dim * (config.input_sequence_length - 1)) + ["walls"] * (2 * config.dim)
        names += ["type"] * config.type_size + list(config.material_features)
        return [*names, "neighbours", "distance of neighbours", "speed against neighbours", *["gravity"] * config.dim]

    def normalised_acceleration(
        self, history: Tensor, scenes: SceneBatch, *, search: Search | None = None, network: Evaluation | None = None
    ) -> Tensor:
        """Return the network's (ẍ − `acceleration_mean`) / `acceleration_std`, gravity in it [N, D].

        Args:
            history: [N, H, D] [m].
            scenes: those that are stepped.
            search: as of `Simulator.features`.
            network: evaluated in the place of the simulator's own.
        """
        node, edge_index = self.features(history, scenes, search)
        edge = edge_features(history[:, -1], edge_index, self.config.connectivity_radius)
        output: Tensor = (network or self.network)(node, edge, edge_index)
        return output

    def target(self, history: Tensor, next_position: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the normalised acceleration that carries `history` to `next_position` in one step [N, D].

        Args:
            history: [N, H, D] [m].
            next_position: [N, D] [m].
            scenes: those that are stepped.
        """
        second_difference = next_position - 2 * history[:, -1] + history[:, -2]
        return (second_difference - self.acceleration_mean) / self.acceleration_std

    def integrate(self, history: Tensor, normalised: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the next position [N, D] [m]; one that would cross the whole box in a step becomes NaN.

        Args:
            history: [N, H, D] [m].
            normalised: as of `normalised_acceleration` [N, D].
            scenes: those that are stepped.
        """
        acceleration = normalised * self.acceleration_std + self.acceleration_mean
        step = history[:, -1] - history[:, -2] + acceleration
        size = scenes.of_particles(scenes.upper) - scenes.of_particles(scenes.lower)
        position = torch.where(step.abs() > size, torch.nan, history[:, -1] + step)
        return torch.where(scenes.moved[:, None], position, history[:, -1])


def cold_start(config: SimulatorConfig, provenance: Mapping[str, Any]) -> str | None:
    """Return in a sentence how runs of imported weights start here and in their own program; None for other models.

    Models that are trained here learn from histories that begin before the first frame; imported weights never saw one.

    Args:
        config: of the simulator.
        provenance: of its checkpoint.
    """
    if not isinstance(config, FrameConfig) or "weights" not in provenance:
        return None
    return (
        f"Imported weights: their own program starts from {config.input_sequence_length} true frames. A run here "
        "starts from one frame and its velocities, as if these had been constant before, so that it differs from "
        "theirs from the first step on; evaluate.py starts from true frames with evaluation.start=frames."
    )


def with_self_loops(edge_index: Tensor, number: int) -> Tensor:
    """Return edges with one from every particle to itself, sorted by receiver, then by sender [2, E + N].

    Args:
        edge_index: sorted, without such edges [2, E].
        number: N.
    """
    own = torch.arange(number, device=edge_index.device)
    sender, receiver = torch.cat([edge_index, torch.stack([own, own])], dim=1)
    order = torch.argsort(receiver * number + sender)
    return torch.stack([sender[order], receiver[order]])
