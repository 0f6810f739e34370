"""The learned simulator: one step, and nothing else.

normalise → graph → network → denormalise → integrate. It holds no `no_grad`, no device choice and no logging, so that
training, rollout and inverse problems share it. `rollout` unrolls it, `training` fits it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, edge_features, edge_width, node_features, node_width, radius_graph, surroundings
from gns_pl.graph.features import in_precision, near_surfaces, touched, turn, turned_edges, turned_nodes
from gns_pl.machine import compiles
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.step_loops import gated_in_contact, integrated
from gns_pl.nn import build_network, in_float32

Search = Callable[..., Tensor]
"""Finds neighbours: arguments and result of `radius_graph`."""

Evaluation = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Node features [N, F], edge features [E, F'] and edges [2, E] → outputs [N, O]."""


class Simulator(nn.Module):
    """One step of granular flow, learned.

    The statistics are persistent buffers: `velocity_scale` [] [m/s] and `acceleration_scale` [] [m/s²] are root mean
    squares over all axes (means are not subtracted, so that free fall stays exactly zero after gravity is),
    `material_scale` [2, K] holds mean and standard deviation of the material features.

    Args:
        config: its shape.

    """

    config_class: ClassVar[type[SimulatorConfig]] = SimulatorConfig
    """What rebuilds it; a subclass with more settings has its own."""

    velocity_scale: Tensor
    acceleration_scale: Tensor
    material_scale: Tensor

    @in_float32
    def __init__(self, config: SimulatorConfig) -> None:
        super().__init__()
        self.config = config
        features = len(config.material_features)
        self.register_buffer("velocity_scale", torch.ones(()))
        self.register_buffer("acceleration_scale", torch.ones(()))
        self.register_buffer("material_scale", torch.stack([torch.zeros(features), torch.ones(features)]))
        self.network = build_network(
            config.network,
            node_width=self.node_width(),
            edge_width=edge_width(config.dim),
            output_width=config.dim * (1 if config.output == "acceleration" else 2),
            latent_size=config.latent_size,
            num_mlp_layers=config.num_mlp_layers,
            num_message_passing_steps=config.num_message_passing_steps,
        )

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.velocity_scale.device

    @property
    def history_length(self) -> int:
        """Positions that a step looks at, H."""
        return self.config.input_sequence_length

    def node_width(self) -> int:
        """Return the width of the node features."""
        config = self.config
        return node_width(
            dim=config.dim,
            input_sequence_length=config.input_sequence_length,
            num_particle_types=len(config.particle_types),
            num_material_features=len(config.material_features),
            context=config.context,
        )

    def fit_statistics(self, moments: Mapping[str, Any], *, gravity: float, noise_std: float, material: Tensor) -> None:
        """Set the normalisation from that of a data set: root mean squares over all components, noise included.

        Args:
            moments: "velocity" [m/s] and "acceleration" [m/s²] → "mean" and "std" per axis [D].
            gravity: magnitude, along the last axis [m/s²].
            noise_std: of the latest displacement's random-walk noise in the training [m].
            material: mean and standard deviation of the material features [2, K].

        Raises:
            InputError: the data do not move.
        """
        velocity = [m**2 + s**2 for m, s in zip(moments["velocity"]["mean"], moments["velocity"]["std"], strict=True)]
        mean = list(moments["acceleration"]["mean"])
        mean[-1] += gravity
        acceleration = [m**2 + s**2 for m, s in zip(mean, moments["acceleration"]["std"], strict=True)]
        noise = noise_std / self.config.dt
        self.set_statistics(
            velocity=math.sqrt(sum(velocity) / len(velocity) + noise**2),
            acceleration=math.sqrt(sum(acceleration) / len(acceleration) + (noise / self.config.dt) ** 2),
            material=material,
        )

    def set_statistics(self, *, velocity: float, acceleration: float, material: Tensor) -> None:
        """Set the normalisation.

        Args:
            velocity: root mean square of a velocity component, noise included [m/s].
            acceleration: root mean square of a component of a − g, noise included [m/s²].
            material: mean and standard deviation of the material features [2, K].

        Raises:
            InputError: a scale that is not positive and finite: the data do not move.
        """
        for name, value in (("velocity", velocity), ("acceleration", acceleration)):
            if not (value > 0 and value < float("inf")):
                raise InputError(f"the {name} statistics of the data are {value}; a simulator needs moving particles.")
        self.velocity_scale.fill_(velocity)
        self.acceleration_scale.fill_(acceleration)
        self.material_scale.copy_(material)

    def features(self, history: Tensor, scenes: SceneBatch, search: Search | None = None) -> tuple[Tensor, Tensor]:
        """Return what every particle knows of itself [N, F], and the edges [2, E].

        Args:
            history: positions of the last H frames, the latest last [N, H, D] [m].
            scenes: those that are stepped.
            search: finds the neighbours, with the arguments and the result of `radius_graph`, which it is without one.
        """
        config = self.config
        position = history[:, -1]
        velocity = history.diff(dim=1) / config.dt
        edge_index = (search or radius_graph)(
            position,
            config.connectivity_radius,
            scenes.batch,
            backend=config.neighbours,
            num_graphs=scenes.num_graphs,
        )
        node = node_features(
            velocity,
            position,
            scenes,
            velocity_scale=self.velocity_scale,
            radius=config.connectivity_radius,
            spacing=config.spacing,
            particle_types=config.particle_types,
            material_scale=self.material_scale,
            context=config.context,
            surfaces=config.sees_surfaces,
        )
        node = turned_nodes(node, self._upright(scenes), config.input_sequence_length - 1, config.context)
        return node, edge_index

    def state(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return all that a step depends on of every particle and its surroundings, by which states are compared.

        Features, `graph.surroundings`, and what gravity adds to a velocity in a step, over `velocity_scale`.

        Args:
            history: [N, H, D] [m].
            scenes: those that are stepped.

        Returns:
            [N, F + 3 + D], as `state_names`.
        """
        config = self.config
        node, edge_index = self.features(history, scenes)
        velocity = (history[:, -1] - history[:, -2]) / (config.dt * self.velocity_scale)
        near = surroundings(history[:, -1], velocity, edge_index, config.connectivity_radius)
        gravity = scenes.of_particles(scenes.gravity) * config.dt / self.velocity_scale
        return torch.cat([node, near, gravity.expand_as(velocity)], dim=1)

    def state_names(self) -> list[str]:
        """Return in a word what each column of `state` is about."""
        config = self.config
        names = ["velocity"] * (config.dim * (config.input_sequence_length - 1))
        walls = ["surfaces", "friction of surfaces"] if config.sees_surfaces else ["walls", "walls"]
        names += [name for name in walls for _ in range(config.dim)]
        if config.context:
            names += ["floor", "overburden", "empty height", "density", *["momentum above"] * config.dim]
        names += ["type"] * (len(config.particle_types) if len(config.particle_types) > 1 else 0)
        names += config.material_features
        return [*names, "neighbours", "distance of neighbours", "speed against neighbours", *["gravity"] * config.dim]

    def normalised_acceleration(
        self, history: Tensor, scenes: SceneBatch, *, search: Search | None = None, network: Evaluation | None = None
    ) -> Tensor:
        """Return the network's (a − g) / `acceleration_scale` [N, D].

        It is a contact force over a mass, so it is exactly zero for a particle that has neither a neighbour nor a wall
        within the connectivity radius: such a particle falls freely, whatever the weights are.

        Args:
            history: positions of the last H frames, the latest last [N, H, D] [m].
            scenes: those that are stepped.
            search: as of `features`.
            network: evaluated in the place of the simulator's own.
        """
        config, position = self.config, history[:, -1]
        node, edge_index = self.features(history, scenes, search)
        rotation = self._upright(scenes)
        edge = edge_features(position, edge_index, config.connectivity_radius)
        edge = turned_edges(edge, rotation, edge_index)
        output: Tensor = (network or self.network)(node, edge, edge_index)
        in_box = not config.sees_surfaces
        in_loops = in_box and config.output != "switched"
        if in_loops and compiles(history, output, backward=True) and self._compiles(scenes):
            scales, boxes = self._numbers(), self._boxes(scenes)
            arrays = (edge_index.numpy(), *boxes, np.float32(config.connectivity_radius))
            return gated_in_contact(output, history, config.output == "gated", *scales, *arrays)
        velocity = (position - history[:, -2]) / config.dt
        if config.output != "acceleration":
            increment, gate = output.chunk(2, dim=1)
            held = torch.sigmoid(-gate) if config.output == "gated" else torch.nn.functional.hardsigmoid(-gate)
            falling = velocity / config.dt + scenes.of_particles(scenes.gravity)  # (v + g Δt) / Δt
            falling = turn(falling, rotation)
            output = increment - held * falling / self.acceleration_scale
        contact = self._at_wall(position, scenes) if in_box else near_surfaces(node, history[:, 1:])
        output = turn(output, None if rotation is None else rotation.mT)
        output = torch.where(touched(edge_index, contact)[:, None], output, 0.0)
        if config.walls != "contacts" or scenes.surfaces is None:
            return output
        free = velocity + config.dt * (output * self.acceleration_scale + scenes.of_particles(scenes.gravity))
        sizes = {"radius": config.connectivity_radius, "touching": config.spacing / 2, "ahead": config.dt / 2}
        contacts = scenes.surfaces.contacts(free, position, scenes.batch, **sizes)
        return output + contacts / (config.dt * self.acceleration_scale)

    def _upright(self, scenes: SceneBatch) -> Tensor | None:
        """Return how its vectors are turned [N or 1, D, D], so that a tilted box is a slope; None: they are not."""
        upright = scenes.upright if self.config.walls == "contacts" else None
        return None if upright is None else scenes.of_particles(upright)

    def _at_wall(self, position: Tensor, scenes: SceneBatch) -> Tensor:
        """Return which particles have a wall within the connectivity radius [N] bool."""
        radius = self.config.connectivity_radius
        lower, upper = scenes.of_particles(scenes.lower), scenes.of_particles(scenes.upper)
        return ((position - lower < radius) | (upper - position < radius)).any(dim=1)

    def target(self, history: Tensor, next_position: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the normalised a − g that carries `history` to `next_position` in one step [N, D].

        Args:
            history: [N, H, D] [m].
            next_position: [N, D] [m].
            scenes: those that are stepped.
        """
        second_difference = next_position - 2 * history[:, -1] + history[:, -2]
        acceleration = second_difference / self.config.dt**2
        return (acceleration - scenes.of_particles(scenes.gravity)) / self.acceleration_scale

    def integrate(self, history: Tensor, normalised: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the next position by semi-implicit Euler: v' = v + a Δt, x' = x + v' Δt [N, D] [m].

        Walls are rigid: a particle that would leave the box is put onto its face, one that would enter an obstacle or
        the ground onto its surface. One that would cross the whole box in a step becomes NaN, so that walls never hide
        an explosion. Kinematic particles stay where they are; whoever unrolls the simulator moves them along their
        script.

        Args:
            history: [N, H, D] [m].
            normalised: (a − g) / `acceleration_scale` [N, D].
            scenes: those that are stepped.
        """
        if compiles(history, normalised, backward=True) and self._compiles(scenes):
            dt, scale = self._numbers()
            position = integrated(history, normalised, scale, dt, *self._boxes(scenes), scenes.moved.numpy())
            return self._kept_out(position, history, scenes)
        acceleration = normalised * self.acceleration_scale + scenes.of_particles(scenes.gravity)
        velocity = (history[:, -1] - history[:, -2]) / self.config.dt + acceleration * self.config.dt
        step = velocity * self.config.dt
        lower, upper = scenes.of_particles(scenes.lower), scenes.of_particles(scenes.upper)
        position = torch.clamp(history[:, -1] + step, lower, upper)
        position = torch.where(step.abs() > upper - lower, torch.nan, position)
        position = torch.where(scenes.moved[:, None], position, history[:, -1])
        return self._kept_out(position, history, scenes)

    def _kept_out(self, position: Tensor, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return positions of which the moved ones lie in nothing rigid; those of a simulator of boxes as they are."""
        if not self.config.sees_surfaces or scenes.surfaces is None or not scenes.surfaces.inner:
            return position
        return torch.where(scenes.moved[:, None], scenes.surfaces.keep_out(position, scenes.batch), history[:, -1])

    def _compiles(self, scenes: SceneBatch) -> bool:
        """Return whether compiled loops take what has no derivative in them."""
        return compiles(self.acceleration_scale, scenes.lower, scenes.upper, scenes.gravity)

    def _numbers(self) -> tuple[np.float32, np.float32]:
        """Return time of a step [s] and scale of accelerations [m/s²], for compiled loops."""
        return np.float32(self.config.dt), np.float32(self.acceleration_scale)

    @staticmethod
    def _boxes(scenes: SceneBatch) -> tuple[NDArray[Any], ...]:
        """Return corners and gravity of every box, and the box of every particle, for compiled loops."""
        return tuple(value.numpy() for value in (scenes.lower, scenes.upper, scenes.gravity, scenes.batch))

    def forward(
        self, history: Tensor, scenes: SceneBatch, *, search: Search | None = None, network: Evaluation | None = None
    ) -> Tensor:
        """Return the positions one step later [N, D] [m], in the weights' precision.

        Args:
            history: positions of the last H frames, the latest last [N, H, D] [m].
            scenes: those that are stepped.
            search: as of `features`.
            network: evaluated in the place of the simulator's own.
        """
        history, scenes = in_precision(history, scenes, self.velocity_scale.dtype)
        normalised = self.normalised_acceleration(history, scenes, search=search, network=network)
        return self.integrate(history, normalised, scenes)
