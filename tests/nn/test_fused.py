"""The kernels against the plain network: on a GPU, or in Triton's interpreter, which runs their lines in NumPy."""

from __future__ import annotations

import os
from typing import Any

import pytest
import torch
from torch import Tensor

from gns_pl.graph import radius_graph
from gns_pl.nn import EncodeProcessDecode

pytest.importorskip("triton")
if not torch.cuda.is_available() and "TRITON_INTERPRET" not in os.environ:
    pytest.skip("runs in the interpreter from test_fused_interpreted.py", allow_module_level=True)
from gns_pl.graph.bounded import BoundedSearch
from gns_pl.nn.fused import FusedNetwork, GroupedEdges

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
CASES: list[dict[str, Any]] = [
    {"latent_size": 16, "num_mlp_layers": 1, "num_message_passing_steps": 1},
    {"latent_size": 32, "num_mlp_layers": 2, "num_message_passing_steps": 2},
    {"latent_size": 32, "num_mlp_layers": 1, "num_message_passing_steps": 3, "static_edges": True},
]


def make(case: dict[str, Any]) -> tuple[EncodeProcessDecode, Tensor, Tensor, Tensor]:
    """Return a network and a graph in which the first node has no neighbour."""
    torch.manual_seed(0)
    network = EncodeProcessDecode(node_width=9, edge_width=4, output_width=6, **case).eval().to(DEVICE)
    for name, value in network.named_parameters():
        if name.endswith("bias"):
            torch.nn.init.normal_(value, std=0.3)
    position = torch.rand(70, 3)
    position[0] = 5.0
    edge_index = radius_graph(position, 0.3)
    node, edge = torch.randn(70, 9), torch.randn(edge_index.shape[1], 4)
    return network, node.to(DEVICE), edge.to(DEVICE), edge_index.to(DEVICE)


def plain(network: EncodeProcessDecode, *arguments: Tensor) -> Tensor:
    """Return what PyG's layers give."""
    network.compiled_edges = False
    try:
        return network(*arguments)
    finally:
        network.compiled_edges = True


def difference(one: Tensor, other: Tensor) -> float:
    """Return the largest difference in units of the root mean square."""
    return float((one - other).abs().max() / other.square().mean().sqrt())


@torch.no_grad()
@pytest.mark.parametrize("case", CASES)
def test_kernels_agree_with_the_plain_network(case: dict[str, Any]) -> None:
    network, *graph = make(case)
    assert difference(FusedNetwork(network, "float32")(*graph), plain(network, *graph)) < 1e-5
    assert 1e-5 < difference(FusedNetwork(network, "tf32")(*graph), plain(network, *graph)) < 2e-2


@pytest.mark.gpu
@torch.no_grad()
@pytest.mark.parametrize("case", CASES)
def test_a_network_on_a_gpu_uses_the_kernels(case: dict[str, Any]) -> None:
    network, *graph = make(case)
    expected = plain(network, *graph)
    assert torch.equal(network(*graph), FusedNetwork(network, "float32")(*graph))
    with torch.autocast("cuda", dtype=torch.bfloat16):
        assert 1e-4 < difference(network(*graph), expected) < 0.2
    network.node_encoder[0].weight.mul_(2)  # new weights are seen
    assert difference(network(*graph), plain(network, *graph)) < 1e-5


@torch.no_grad()
def test_padding_changes_nothing() -> None:
    network, node, edge, edge_index = make(CASES[1])
    fused = FusedNetwork(network, "float32")
    padding = torch.full((2, 13), len(node) - 1, device=DEVICE)
    padded = fused(node, torch.cat([edge, edge.new_ones(13, 4)]), torch.cat([edge_index, padding], dim=1))
    assert torch.equal(padded, fused(node, edge, edge_index))


def test_every_edge_has_a_place_among_its_receivers() -> None:
    _, node, _, edge_index = make(CASES[0])
    grouped = GroupedEdges.of(edge_index, len(node), 64)
    assert torch.equal(grouped.sender[grouped.place].long(), edge_index[0])
    assert torch.equal(grouped.receiver[grouped.place // 8].long(), edge_index[1])
    assert len(grouped.place.unique()) == int((grouped.sender >= 0).sum()) == edge_index.shape[1]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("num_graphs", [1, 2])
def test_the_bounded_search_finds_the_same_edges(dim: int, num_graphs: int) -> None:
    torch.manual_seed(0)
    position = torch.rand(40, dim)
    batch = torch.arange(40) * num_graphs // 40
    expected = radius_graph(position, 0.3, batch, num_graphs=num_graphs)
    number = expected.shape[1]
    search = BoundedSearch(number + 37)
    found = search(position.to(DEVICE), 0.3, batch.to(DEVICE), num_graphs=num_graphs).cpu()
    assert int(search.wanted) == number
    assert bool((found[:, number:] == 39).all())
    assert bool((found[1].diff() >= 0).all())
    found = found[:, :number]
    assert torch.equal(found[:, torch.argsort(found[1] * 40 + found[0])], expected)


def test_the_bounded_search_says_what_it_had_no_room_for() -> None:
    torch.manual_seed(0)
    position = torch.rand(25, 3)
    search = BoundedSearch(20)
    assert search(position.to(DEVICE), 0.3).shape == (2, 20)
    assert int(search.wanted) == radius_graph(position, 0.3).shape[1] > 20
