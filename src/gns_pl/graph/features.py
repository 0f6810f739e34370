"""Node and edge features of the graph, and how wide they are: the only place where a width is computed."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.graph.context import EMPTY, REACH, ContextGrid, context_fields
from gns_pl.graph.features_in_loops import NodeConstants, edges_in_loops, nodes_in_loops
from gns_pl.graph.surfaces import Surfaces
from gns_pl.machine import compiles


@dataclass(frozen=True)
class SceneBatch:
    """What does not change while a batch of B scenes with N particles in all is stepped.

    Attributes:
        particle_type: [N] `ParticleType`.
        material: [N, K] material features.
        volume: volume that every particle stands for [N] [m^D].
        lower: lower corner of every box [B, D] [m].
        upper: upper corner of every box [B, D] [m].
        gravity: [B, D] [m/s²].
        batch: [N] scene of every particle, ascending.
        surfaces: what is rigid around particles; None for simulators that know the box alone.
    """

    particle_type: Tensor
    material: Tensor
    volume: Tensor
    lower: Tensor
    upper: Tensor
    gravity: Tensor
    batch: Tensor
    surfaces: Surfaces | None = None
    _grids: dict[tuple[float, int | None], ContextGrid] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def num_graphs(self) -> int:
        """B."""
        return int(self.lower.shape[0])

    @property
    def moved(self) -> Tensor:
        """[N] bool: particles the simulator moves, all but the kinematic ones."""
        return self.particle_type != int(ParticleType.KINEMATIC)

    @functools.cached_property
    def upright(self) -> Tensor | None:
        """[B, D, D] rotations that turn gravity to where it is by custom, down the last axis; None if it is there."""
        if not bool((self.gravity[:, :-1] != 0).any()):
            return None
        size = self.gravity.norm(dim=1, keepdim=True)
        down = torch.zeros_like(self.gravity)
        down[:, -1] = -1
        along = torch.where(size > 0, self.gravity / size, down)
        cosine = (along * down).sum(dim=1)[:, None, None]
        turn = down[:, :, None] * along[:, None] - along[:, :, None] * down[:, None]
        return torch.eye(len(down[0])).to(turn) + turn + turn @ turn / (1 + cosine).clamp_min(1e-3)

    def to(self, device: torch.device | str) -> SceneBatch:
        """Return the same on another device."""
        values: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.init}
        return replace(self, **{name: value.to(device) for name, value in values.items() if value is not None})

    def in_precision(self, dtype: torch.dtype) -> SceneBatch:
        """Return the same with its numbers in another precision; this very object if they are in it."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.init}
        tensors = {name: value for name, value in values.items() if isinstance(value, Tensor)}
        wrong = {name: value for name, value in tensors.items() if value.is_floating_point() and value.dtype != dtype}
        changed: dict[str, Any] = {name: value.to(dtype) for name, value in wrong.items()}
        surfaces = self.surfaces and self.surfaces.in_precision(dtype)
        if surfaces is not self.surfaces:
            changed["surfaces"] = surfaces
        return replace(self, **changed) if changed else self

    def of_particles(self, value: Tensor) -> Tensor:
        """Return what holds for every particle's scene [N, …], of one scene [1, …] (broadcast: N copies cost time).

        Args:
            value: one row per scene [B, …].
        """
        return value if self.num_graphs == 1 else value[self.batch]

    def grid(self, cell: float, *, axes: int | None = None) -> ContextGrid:
        """Return a grid over the boxes, made once.

        Args:
            cell: edge of its cells [m].
            axes: how many of the axes it has, from the first on; None: all.
        """
        lower, upper = self.lower[:, :axes], self.upper[:, :axes]
        if torch.compiler.is_exporting():  # the box is an input of the program, so the grid is made in every step
            return ContextGrid.of(lower, upper, cell)
        if (cell, axes) not in self._grids:
            with torch.inference_mode(False), torch.no_grad():  # so that a later step may have gradients
                self._grids[cell, axes] = ContextGrid.of(lower, upper, cell)
        return self._grids[cell, axes]


def in_precision(history: Tensor, scenes: SceneBatch, dtype: torch.dtype) -> tuple[Tensor, SceneBatch]:
    """Return what a step is made from in the precision of the weights that make it."""
    return history.to(dtype), scenes.in_precision(dtype)


def node_width(
    *,
    dim: int,
    input_sequence_length: int,
    num_particle_types: int,
    num_material_features: int,
    context: bool,
) -> int:
    """Return F of `node_features`."""
    types = num_particle_types if num_particle_types > 1 else 0
    return (input_sequence_length - 1) * dim + 2 * dim + (4 + dim) * int(context) + types + num_material_features


def node_features(
    velocity: Tensor,
    position: Tensor,
    scenes: SceneBatch,
    *,
    velocity_scale: Tensor,
    radius: float,
    spacing: float,
    particle_types: tuple[int, ...],
    material_scale: Tensor,
    context: bool,
    surfaces: bool = False,
) -> Tensor:
    """Return what a particle knows of itself (Sanchez-Gonzalez et al. 2020, section 3).

    Args:
        velocity: past velocities, the latest last [N, H − 1, D] [m/s].
        position: latest position [N, D] [m].
        scenes: those that are stepped.
        velocity_scale: [] [m/s], velocities are divided by it.
        radius: connectivity radius R [m]; distances to the walls are cut to ± R and divided by it.
        spacing: of the particles [m].
        particle_types: the types that occur; coded one-hot if there are several.
        material_scale: [2, K] mean and standard deviation of the material features.
        context: add the distance to the floor within `REACH` radii, thickness and momentum of the overburden, the empty
            height below within `EMPTY` radii and the density of particles, in units of one per cell of the lattice.
        surfaces: in the place of distances to the walls stand `approach` and `grip` of `scenes.surfaces`, and the
            context is that over the ground: heights are less those of the ground below, as if it had been levelled.

    Returns:
        [N, F]: velocities, distances to the lower and upper walls or what is seen of surfaces, context, type, material.

    Raises:
        InputError: surfaces are wanted, and the scenes were made without.
    """
    if surfaces:
        if scenes.surfaces is None:
            raise InputError("this simulator sees surfaces: make its scenes by static_of(…, config=simulator.config).")
        seen = scenes.surfaces.fields(position, scenes.batch, radius)
        level = position[:, -1] - seen.ground + scenes.of_particles(scenes.lower)[:, -1]
        in_box = node_features(
            velocity,
            torch.cat([position[:, :-1], level[:, None]], dim=1),
            scenes,
            velocity_scale=velocity_scale,
            radius=radius,
            spacing=spacing,
            particle_types=particle_types,
            material_scale=material_scale,
            context=context,
        )
        motion, _, rest = in_box.tensor_split(_wall_columns(velocity), dim=1)
        return torch.cat([motion, seen.approach, seen.grip, rest], dim=1)
    kinds = particle_types if len(particle_types) > 1 else ()
    able = compiles(velocity, position, scenes.material, backward=True)
    able = able and compiles(velocity_scale, material_scale, scenes.lower, scenes.upper, scenes.volume)
    grid = scenes.grid(radius).arrays if able and context else None
    if able and (grid is not None or not context):
        arrays = (scenes.lower, scenes.upper, scenes.batch, scenes.volume, scenes.particle_type)
        lower, upper, batch, volume, types = (tensor.contiguous().numpy() for tensor in arrays)
        width = node_width(
            dim=position.shape[1],
            input_sequence_length=velocity.shape[1] + 1,
            num_particle_types=len(kinds),
            num_material_features=material_scale.shape[1],
            context=context,
        )
        of_kinds, scale = np.array(kinds, np.int64), material_scale.contiguous().numpy()
        numbers = (np.float32(velocity_scale), radius, spacing)
        constants = NodeConstants(width, lower, upper, batch, volume, types, of_kinds, scale, *numbers, grid)
        return nodes_in_loops(velocity, position, scenes.material, constants)
    to_lower = position - scenes.of_particles(scenes.lower)
    to_upper = scenes.of_particles(scenes.upper) - position
    walls = torch.cat([to_lower, to_upper], dim=1) / radius
    parts = [(velocity / velocity_scale).flatten(1), walls.clamp(-1, 1)]
    if context:
        thickness, momentum, empty, fraction = context_fields(
            position, velocity[:, -1], scenes.grid(radius), scenes.batch, volume=scenes.volume
        )
        floor = (to_lower[:, -1] / (REACH * radius)).clamp(-1, 1)
        empty = (empty / radius).clamp(-EMPTY, EMPTY)
        # Particles of a thinned set stand for more or less than their lattice cell, by up to a tenth in small bodies.
        # What is sound is one particle per cell, whatever it weighs: thus the density of particles, not of volume.
        fraction = fraction * spacing ** position.shape[1] / scenes.volume
        parts.append(torch.stack([floor, thickness / (REACH * radius), empty, 2 * fraction], dim=1))
        parts.append(momentum / (REACH * radius * velocity_scale))
    if kinds:
        parts.append(torch.stack([scenes.particle_type == kind for kind in kinds], dim=1).to(position.dtype))
    used = material_scale.shape[1]
    if used:
        parts.append((scenes.material[:, :used] - material_scale[0]) / material_scale[1])
    return torch.cat(parts, dim=1)


def turned_nodes(node: Tensor, rotation: Tensor | None, velocities: int, context: bool) -> Tensor:
    """Return features of a simulator that sees surfaces, with their vectors turned [N, F].

    Args:
        node: features of `node_features` [N, F].
        rotation: `SceneBatch.upright` of the particles [N or 1, D, D]; None turns nothing.
        velocities: number of past velocities, H − 1.
        context: whether there is one.
    """
    if rotation is None:
        return node
    dim = rotation.shape[-1]
    begins = [*range(0, (velocities + 2) * dim, dim)]  # velocities, approach, grip
    if context:
        begins.append(begins[-1] + dim + 4)  # momentum above
    node = node.clone()
    for begin in begins:
        node[:, begin : begin + dim] = turn(node[:, begin : begin + dim].clone(), rotation)
    return node


def turned_edges(edge: Tensor, rotation: Tensor | None, edge_index: Tensor) -> Tensor:
    """Return edge features with their displacements turned, arguments as of `turned_nodes` [E, D + 1]."""
    if rotation is None:
        return edge
    of_edges = rotation if len(rotation) == 1 else rotation[edge_index[1]]
    return torch.cat([turn(edge[:, :-1], of_edges), edge[:, -1:]], dim=1)


def turn(vector: Tensor, rotation: Tensor | None) -> Tensor:
    """Return vectors [N, D] turned by rotations [N or 1, D, D], or as they are."""
    return vector if rotation is None else (rotation @ vector[..., None])[..., 0]


def _wall_columns(velocity: Tensor) -> tuple[int, int]:
    """Return the first column of node features about walls and the one behind; of velocities [N, H − 1, D]."""
    begin = velocity.shape[1] * velocity.shape[2]
    return begin, begin + 2 * velocity.shape[2]


def near_surfaces(node: Tensor, velocity: Tensor) -> Tensor:
    """Return which particles have a surface within the radius [N] bool.

    Args:
        node: features of `node_features`, with surfaces.
        velocity: of which they were made [N, H − 1, D] [m/s].
    """
    begin, end = _wall_columns(velocity)
    return (node.detach()[:, begin:end] != 0).any(dim=1)


def touched(edge_index: Tensor, contact: Tensor) -> Tensor:
    """Return which particles have a neighbour, or are in contact anyway [N] bool.

    Args:
        edge_index: [2, E].
        contact: [N] bool.
    """
    sender, receiver = edge_index
    met = contact.new_zeros(len(contact) + 1)
    met.index_fill_(0, torch.where(sender == receiver, len(contact), receiver), True)  # a node itself is padding
    return contact | met[:-1]


def edge_width(dim: int) -> int:
    """Return the width of `edge_features`."""
    return dim + 1


def edge_features(position: Tensor, edge_index: Tensor, radius: float) -> Tensor:
    """Return displacement from receiver to sender over R, and its length [E, D + 1].

    Args:
        position: [N, D] [m].
        edge_index: [2, E], sender and receiver.
        radius: connectivity radius R [m].
    """
    if compiles(position, backward=True):
        return edges_in_loops(position, edge_index, radius)
    displacement = (position[edge_index[0]] - position[edge_index[1]]) / radius
    return torch.cat([displacement, displacement.norm(dim=1, keepdim=True)], dim=1)
