"""Features without a derivative, which compiled loops make on a CPU, against those with one, which torch makes."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

import gns_pl.graph.context
from gns_pl.graph import SceneBatch, edge_features, node_features, radius_graph

RADIUS = 0.07


def make_scenes(dim: int, boxes: int, number: int = 300) -> tuple[Tensor, Tensor, SceneBatch]:
    """Velocities and positions, some of them outside of their box, of particles of two types and all volumes."""
    draw = torch.Generator().manual_seed(dim + boxes)
    scenes = SceneBatch(
        particle_type=torch.randint(5, 7, (number,), generator=draw),
        material=torch.rand(number, 2, generator=draw),
        volume=1e-4 * (1 + torch.rand(number, generator=draw)),
        lower=0.1 * torch.rand(boxes, dim, generator=draw),
        upper=0.7 + 0.5 * torch.rand(boxes, dim, generator=draw),
        gravity=torch.zeros(boxes, dim),
        batch=torch.randint(0, boxes, (number,), generator=draw).sort().values,
    )
    velocity = torch.randn(number, 3, dim, generator=draw)
    return velocity, torch.rand(number, dim, generator=draw) - 0.05, scenes


def features(velocity: Tensor, position: Tensor, scenes: SceneBatch, **changes: Any) -> Tensor:
    settings: dict[str, Any] = {
        "velocity_scale": torch.tensor(0.7, dtype=position.dtype),
        "radius": RADIUS,
        "spacing": 0.04,
        "particle_types": (5, 6),
        "material_scale": torch.tensor([[0.5, 0.4], [0.1, 0.2]]),
        "context": True,
    }
    return node_features(velocity, position, scenes, **(settings | changes))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("boxes", [1, 3])
@pytest.mark.parametrize("changes", [{}, {"context": False}, {"particle_types": (6,)}])
def test_nodes(dim: int, boxes: int, changes: dict[str, Any]) -> None:
    velocity, position, scenes = make_scenes(dim, boxes)
    got = features(velocity, position, scenes, **changes)
    assert not got.requires_grad
    expected = features(velocity, position.requires_grad_(), scenes, **changes)
    assert expected.requires_grad
    torch.testing.assert_close(got, expected.detach(), atol=1e-5, rtol=2e-6)


def test_a_box_whose_nodes_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gns_pl.graph.context, "DENSE_NODES", 10)
    velocity, position, scenes = make_scenes(3, 2)
    got = features(velocity, position, scenes)
    assert torch.equal(got, features(velocity, position.requires_grad_(), scenes))


def test_double_precision_stays() -> None:
    velocity, position, scenes = make_scenes(3, 1)
    velocity, position, scenes = velocity.double(), position.double(), scenes.in_precision(torch.float64)
    with torch.no_grad():
        assert features(velocity, position, scenes).dtype == torch.float64


@pytest.mark.parametrize("dim", [2, 3])
def test_edges(dim: int) -> None:
    _, position, _ = make_scenes(dim, 1)
    edge_index = radius_graph(position, RADIUS)
    got = edge_features(position, edge_index, RADIUS)
    assert not got.requires_grad
    assert edge_features(position, edge_index[:, :0], RADIUS).shape == (0, dim + 1)
    expected = edge_features(position.requires_grad_(), edge_index, RADIUS)
    assert expected.requires_grad
    torch.testing.assert_close(got, expected.detach(), atol=1e-6, rtol=0)


def test_a_position_that_is_not_finite_breaks_nothing_else() -> None:
    """Who looks for neighbours has refused it before; here it must only stay within the grid's memory."""
    velocity, position, scenes = make_scenes(3, 1)
    position[7] = math.nan
    with torch.no_grad():
        assert features(velocity, position, scenes).shape == (300, 3 * 3 + 6 + 7 + 2 + 2)
