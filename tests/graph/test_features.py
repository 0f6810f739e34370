from __future__ import annotations

import dataclasses
import itertools

import pytest
import torch

from gns_pl.graph import edge_features, edge_width, node_features, node_width
from tests.conftest import make_static

SCALE = torch.tensor([[0.5], [0.1]])


def features(
    position: torch.Tensor, velocity: torch.Tensor, types: tuple[int, ...] = (6,), context: bool = False
) -> torch.Tensor:
    return node_features(
        velocity,
        position,
        make_static(len(position)),
        velocity_scale=torch.tensor(2.0),
        radius=0.1,
        spacing=0.05,
        particle_types=types,
        material_scale=SCALE,
        context=context,
    )


def test_widths_are_those_of_the_features() -> None:
    position, velocity = torch.rand(5, 3), torch.rand(5, 4, 3)
    for types, context in itertools.product(((6,), (3, 6)), (False, True)):
        width = node_width(
            dim=3, input_sequence_length=5, num_particle_types=len(types), num_material_features=1, context=context
        )
        assert features(position, velocity, types, context).shape == (5, width)
    assert edge_features(position, torch.tensor([[0], [1]]), 0.1).shape == (1, edge_width(3))


def test_values() -> None:
    position = torch.tensor([[0.05, 0.5, 1.02]])
    velocity = torch.tensor([[[2.0, 0.0, -4.0]]])
    row = features(position, velocity, (3, 6))[0]
    expected = [1, 0, -2, 0.5, 1, 1, 1, 1, -0.2, 0, 1, 0.77]
    torch.testing.assert_close(row, torch.tensor(expected, dtype=torch.float32), atol=1e-5, rtol=1e-5)


def test_edges_point_from_receiver_to_sender() -> None:
    position = torch.tensor([[0.0, 0.0, 0.0], [0.03, 0.0, 0.04]])
    edges = edge_features(position, torch.tensor([[1], [0]]), 0.1)
    torch.testing.assert_close(edges, torch.tensor([[0.3, 0.0, 0.4, 0.5]]))


def test_density_counts_particles_whatever_they_weigh() -> None:
    """Thinned particles stand for more or less than their cell; a sound lattice is sound all the same."""
    axis = torch.arange(0.025, 1, 0.05)
    position = torch.cartesian_prod(axis, axis, axis[:8])
    rows = []
    for weight in (0.8, 1.0):
        static = dataclasses.replace(make_static(len(position)), volume=torch.full((len(position),), weight * 0.05**3))
        given = {"velocity_scale": torch.tensor(1.0), "radius": 0.1, "spacing": 0.05, "particle_types": (6,)}
        rows.append(node_features(still(position), position, static, **given, material_scale=SCALE, context=True))
    thickness, density = 3 + 6 + 1, 3 + 6 + 3  # behind the velocity and the walls: floor, thickness, empty, density
    torch.testing.assert_close(rows[0][:, density], rows[1][:, density])
    torch.testing.assert_close(rows[0][:, thickness], 0.8 * rows[1][:, thickness])
    assert rows[0][position[:, 2] < 0.25, density].mean() == pytest.approx(2.0, rel=0.02)


def still(position: torch.Tensor) -> torch.Tensor:
    return torch.zeros_like(position)[:, None]
