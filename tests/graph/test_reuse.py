"""A list of neighbours that is kept gives the edges of a new search, and is kept."""

from __future__ import annotations

import pytest
import torch

import gns_pl.graph.reuse
from gns_pl.graph import NeighbourList, radius_graph


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The radii that are searched."""
    seen: list[float] = []

    def watched(position: torch.Tensor, radius: float, *args: object, **kwargs: object) -> torch.Tensor:
        seen.append(radius)
        return radius_graph(position, radius, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(gns_pl.graph.reuse, "radius_graph", watched)
    return seen


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("step", [1e-4, 3e-3, 0.02])
def test_edges_are_those_of_a_new_search(step: float, dtype: torch.dtype, searches: list[float]) -> None:
    generator = torch.Generator().manual_seed(3)
    position = torch.rand(500, 3, generator=generator, dtype=dtype)
    batch = torch.arange(2).repeat_interleave(250)
    neighbours = NeighbourList(0.4)
    for _ in range(40):
        expected = radius_graph(position, 0.15, batch, num_graphs=2)
        assert torch.equal(neighbours(position, 0.15, batch, num_graphs=2), expected)
        position = position + step * torch.randn(position.shape, generator=generator, dtype=dtype)
    # Slow particles need a list or few; fast ones a search in every step.
    assert len(searches) <= {1e-4: 2, 3e-3: 40, 0.02: 40}[step]
    assert (0.15 in searches) == (step > 1e-4)


def test_another_scene_begins_anew() -> None:
    neighbours, batch = NeighbourList(0.5), torch.zeros(100, dtype=torch.int64)
    for number in (100, 60):
        position = torch.rand(number, 3)
        for _ in range(2):
            found = neighbours(position, 0.2, batch[:number].clone())
            assert torch.equal(found, radius_graph(position, 0.2))


def test_what_is_not_finite_is_refused() -> None:
    neighbours, position = NeighbourList(0.5), torch.rand(50, 3)
    neighbours(position, 0.2)
    neighbours(position, 0.2)
    with pytest.raises(ValueError, match="finite"):
        neighbours(torch.full((50, 3), torch.nan), 0.2)
