"""Every backend finds exactly the pairs of the oracle, in any dimension, batch and degenerate arrangement."""

from __future__ import annotations

import importlib.util

import pytest
import torch
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.graph import BACKENDS, NUMBA, radius_graph

HAS_CLUSTER = importlib.util.find_spec("torch_cluster") is not None
FAST = [name for name in (NUMBA, *BACKENDS) if name != "brute_force" and (name != "torch_cluster" or HAS_CLUSTER)]


def oracle(position: Tensor, radius: float) -> set[tuple[int, int]]:
    """Plain loops over all pairs, apart from everything the package does."""
    found = set()
    for i in range(len(position)):
        for j in range(len(position)):
            if i != j and float((position[i] - position[j]).square().sum()) < radius**2:
                found.add((j, i))
    return found


def test_brute_force_against_loops() -> None:
    position = torch.rand(60, 3, generator=torch.Generator().manual_seed(1))
    edges = radius_graph(position, 0.3, backend="brute_force")
    assert set(map(tuple, edges.T.tolist())) == oracle(position, 0.3)


@pytest.mark.parametrize("backend", FAST)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("radius", [0.02, 0.1, 0.35, 3.0])
def test_backend_equals_brute_force(backend: str, dim: int, radius: float) -> None:
    position = torch.rand(400, dim, generator=torch.Generator().manual_seed(2)) * 2 - 0.7
    expected = radius_graph(position, radius, backend="brute_force")
    assert torch.equal(radius_graph(position, radius, backend=backend), expected)


@pytest.mark.parametrize("backend", FAST)
def test_pairs_at_exactly_the_radius(backend: str) -> None:
    """On a lattice many pairs lie at the radius to the last bit; all backends must agree on them."""
    axis = torch.arange(7) * 0.1
    position = torch.cartesian_prod(axis, axis, axis)
    expected = radius_graph(position, 0.2, backend="brute_force")
    assert torch.equal(radius_graph(position, 0.2, backend=backend), expected)


@pytest.mark.parametrize("backend", FAST)
def test_a_clump_is_not_capped(backend: str) -> None:
    position = torch.rand(300, 3, generator=torch.Generator().manual_seed(3)) * 0.01
    assert radius_graph(position, 0.1, backend=backend).shape[1] == 300 * 299


@pytest.mark.parametrize("backend", FAST)
@pytest.mark.parametrize("number", [0, 1, 2])
def test_few_particles(backend: str, number: int) -> None:
    edges = radius_graph(torch.zeros(number, 3), 0.1, backend=backend)
    assert edges.shape == (2, 2 if number == 2 else 0)


@pytest.mark.parametrize("backend", ["brute_force", *FAST])
def test_batches_never_mix_and_receivers_are_sorted(backend: str) -> None:
    generator = torch.Generator().manual_seed(4)
    parts = [torch.rand(number, 3, generator=generator) for number in (50, 1, 80)]
    batch = torch.repeat_interleave(torch.arange(3), torch.tensor([50, 1, 80]))
    edges = radius_graph(torch.cat(parts), 0.4, batch, backend=backend, num_graphs=3)
    assert torch.equal(batch[edges[0]], batch[edges[1]])
    assert bool((edges[1].diff() >= 0).all())
    assert edges.shape[1] == sum(radius_graph(part, 0.4, backend=backend).shape[1] for part in parts)


def test_refusals() -> None:
    position = torch.rand(4, 3)
    with pytest.raises(InputError, match="radius"):
        radius_graph(position, 0.0)
    with pytest.raises(InputError, match="known are"):
        radius_graph(position, 0.1, backend="magic")
    with pytest.raises(InputError, match="finite"):
        radius_graph(torch.full((3, 3), float("nan")), 0.1)
    if not HAS_CLUSTER:
        with pytest.raises(InputError, match="pip install"):
            radius_graph(position, 0.1, backend="torch_cluster")
