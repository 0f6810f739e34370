"""The compiled loops over edges against PyG's way, values and gradients, and what they may be given."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
import torch
from torch import Tensor

from gns_pl.nn import EncodeProcessDecode
from gns_pl.nn.sorted_edges import SortedEdges


@pytest.fixture(params=[True, False], autouse=True)
def packs(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole networks in compiled loops, and torch's products with compiled loops between them."""
    if not request.param:
        monkeypatch.setattr("gns_pl.nn.encode_process_decode.can_pack", lambda network: False)


def make_graph(nodes: int = 40, edges: int = 300) -> tuple[Tensor, Tensor, Tensor]:
    """Random node and edge features; the first and last nodes receive nothing, and some edges are double."""
    generator = torch.Generator().manual_seed(0)
    receiver = torch.randint(1, nodes - 1, (edges,), generator=generator).sort().values
    sender = torch.randint(0, nodes, (edges,), generator=generator)
    node = torch.randn(nodes, 6, generator=generator)
    return node, torch.randn(edges, 4, generator=generator), torch.stack([sender, receiver])


def make_network(num_mlp_layers: int, latent_size: int = 12, **kind: Any) -> EncodeProcessDecode:
    torch.manual_seed(1)
    return EncodeProcessDecode(
        node_width=6,
        edge_width=4,
        output_width=3,
        latent_size=latent_size,
        num_mlp_layers=num_mlp_layers,
        num_message_passing_steps=3,
        **kind,
    )


def results(network: EncodeProcessDecode, node: Tensor, edge: Tensor, edge_index: Tensor) -> list[Tensor]:
    """Output, then the gradients of a nonlinear function of it by inputs and parameters."""
    node, edge = node.clone().requires_grad_(), edge.clone().requires_grad_()
    output = network(node, edge, edge_index)
    wanted = [node, edge, *network.parameters()]
    gradients = torch.autograd.grad(output.sin().sum(), wanted, allow_unused=True)
    return [output, *(torch.zeros(1) if gradient is None else gradient for gradient in gradients)]


@pytest.mark.parametrize("num_mlp_layers", [1, 2])
@pytest.mark.parametrize("edges", [300, 1, 0])
@pytest.mark.parametrize("kind", [{}, {"static_edges": True}])
def test_values_and_gradients_equal_the_plain_way(num_mlp_layers: int, edges: int, kind: dict[str, Any]) -> None:
    """The plain way in float64 is the truth; the compiled loops may be off by rounding in float32."""
    graph, network = make_graph(edges=edges), make_network(num_mlp_layers, **kind)
    got = results(network, *graph)
    expected = results(network.double(), graph[0].double(), graph[1].double(), graph[2])
    for mine, truth in zip(got, expected, strict=True):
        scale = max([1.0, *truth.detach().abs().flatten().tolist()])
        torch.testing.assert_close(mine.double(), truth, atol=3e-5 * scale, rtol=1e-4)


def test_the_norms_own_epsilon_is_used() -> None:
    graph, network = make_graph(), make_network(1)
    for layer in network.processor:
        layer.edge_mlp[-1].eps = 0.5
    compiled = network(*graph)
    network.compiled_edges = False
    torch.testing.assert_close(compiled, network(*graph), atol=1e-5, rtol=1e-4)


def test_the_same_bits_twice() -> None:
    graph, network = make_graph(), make_network(1)
    first, second = results(network, *graph), results(network, *graph)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_unsorted_edges_take_the_plain_way() -> None:
    node, edge, edge_index = make_graph()
    order = torch.randperm(len(edge), generator=torch.Generator().manual_seed(2))
    assert SortedEdges.of(edge_index[:, order], len(node)) is None
    network = make_network(1)
    torch.testing.assert_close(
        network(node, edge[order], edge_index[:, order]), network(node, edge, edge_index), atol=1e-5, rtol=1e-5
    )


def test_nan_stays_nan() -> None:
    """A network that has failed must say so."""
    node, edge, edge_index = make_graph()
    node[int(edge_index[0, 0])] = torch.nan
    output = make_network(1)(node, edge, edge_index)
    assert output[int(edge_index[1, 0])].isnan().all()
    assert output.isfinite().any()


def test_runs_of_every_receiver() -> None:
    edges = SortedEdges.of(torch.tensor([[4, 2, 0, 1], [1, 1, 3, 3]]), 5)
    assert edges is not None
    assert edges.start.tolist() == [0, 0, 2, 2, 4, 4]


@pytest.mark.parametrize("edges", [300, 3, 0])
def test_receivers_shared_among_threads(edges: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three threads give the values and gradients of one, up to the order of sums, and the same bits twice."""
    graph, network = make_graph(edges=edges), make_network(1)
    alone = results(network, *graph)
    monkeypatch.setattr("gns_pl.nn.sorted_edges.LEAST_EDGES", 1)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    parts = SortedEdges.of(graph[2], len(graph[0])).parts  # type: ignore[union-attr]
    assert parts[0][0] == 0 and parts[-1][1] == len(graph[0]) and len(parts) == min(3, max(1, edges))
    assert all(before[1] == after[0] for before, after in itertools.pairwise(parts))
    if edges == 300:
        assert all(80 < int(((graph[2][1] >= low) & (graph[2][1] < high)).sum()) < 120 for low, high in parts)
    shared = results(network, *graph)
    for one, several, again in zip(alone, shared, results(network, *graph), strict=True):
        torch.testing.assert_close(one, several, atol=2e-5, rtol=1e-4)
        assert torch.equal(several, again)
