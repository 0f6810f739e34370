"""The compiled passes of small networks, there and back, against torch's."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from torch import nn

from gns_pl.nn import EncodeProcessDecode
from gns_pl.nn.packed import can_pack
from tests.nn.test_edges import make_graph, make_network, results


def evaluate(network: EncodeProcessDecode, *graph: torch.Tensor) -> torch.Tensor:
    """Evaluate a network without gradients, and see to it that the compiled pass does it."""
    with torch.inference_mode():
        output = network(*graph)
    assert network._packed() is not None
    return output


def plain(network: EncodeProcessDecode, *graph: torch.Tensor) -> torch.Tensor:
    """Evaluate a network in torch's operations."""
    network.compiled_edges = False
    output = network(*graph).detach()
    network.compiled_edges = True
    return output


def shifted(network: EncodeProcessDecode) -> EncodeProcessDecode:
    """Give a network weights of which none is what it starts as: norms, too, and means far from zero."""
    generator = torch.Generator().manual_seed(3)
    for weight in network.parameters():
        weight.data += 0.2 + 0.2 * torch.randn(weight.shape, generator=generator)
    return network


@pytest.mark.parametrize("latent_size", [3, 6, 16, 20, 32, 64])
@pytest.mark.parametrize("num_mlp_layers", [1, 2, 3])
@pytest.mark.parametrize("edges", [300, 1, 0])
def test_it_is_the_network(latent_size: int, num_mlp_layers: int, edges: int) -> None:
    """Of widths that fill no vector, or as many as there are features; with nodes that receive nothing."""
    graph, network = make_graph(edges=edges), shifted(make_network(num_mlp_layers, latent_size))
    output = evaluate(network, *graph)
    assert not output.requires_grad
    torch.testing.assert_close(output, plain(network, *graph), atol=1e-5, rtol=1e-5)
    assert torch.equal(output, evaluate(network, *graph))


@pytest.mark.parametrize("latent_size", [3, 6, 16, 20, 32, 64])
@pytest.mark.parametrize("num_mlp_layers", [1, 2, 3])
@pytest.mark.parametrize("edges", [300, 1, 0])
def test_it_has_the_derivatives_of_the_network(latent_size: int, num_mlp_layers: int, edges: int) -> None:
    """By features and weights, as close to those in double precision as torch's own in single precision are."""
    graph, network = make_graph(edges=edges), make_network(num_mlp_layers, latent_size)
    got = results(network, *graph)
    assert network._packed() is not None
    network.compiled_edges = False
    rounded = results(network, *graph)
    truth = results(network.double(), graph[0].double(), graph[1].double(), graph[2])
    for mine, theirs, exact in zip(got, rounded, truth, strict=True):
        exact = exact.detach()
        largest = float(exact.abs().max()) if exact.numel() else 0.0
        error = 3 * float((theirs.detach() - exact).abs().max()) if exact.numel() else 0.0
        torch.testing.assert_close(mine.double(), exact, rtol=0, atol=error + 1e-5 * largest)


def test_layers_that_pass_nothing_on_have_derivatives() -> None:
    """No layer at all, one, and one whose edges stay as they are."""
    for layers, kind in ((0, {}), (1, {}), (2, {"static_edges": True})):
        torch.manual_seed(0)
        shape = {"node_width": 6, "edge_width": 4, "output_width": 3, "latent_size": 16, "num_mlp_layers": 1}
        network = EncodeProcessDecode(**shape, num_message_passing_steps=layers, **kind)  # type: ignore[arg-type]
        graph = make_graph()
        got = results(network, *graph)
        truth = results(network.double(), graph[0].double(), graph[1].double(), graph[2])
        for mine, exact in zip(got, truth, strict=True):
            exact = exact.detach().double().expand_as(mine)  # zeros of what is not used
            torch.testing.assert_close(mine.double(), exact, rtol=0, atol=1e-5 * max(1.0, float(exact.abs().max())))


def test_it_goes_back_twice_alike() -> None:
    """What the way there keeps is left as it is."""
    (node, *rest), network = make_graph(), make_network(1, 32)
    node.requires_grad_()
    output = network(node, *rest).sin().sum()
    (first,), (second,) = (torch.autograd.grad(output, node, retain_graph=True) for _ in range(2))
    assert torch.equal(first, second)


def test_weights_that_are_held_and_features_that_are_numbers() -> None:
    """Only what wants a derivative gets one."""
    graph, network = make_graph(), make_network(1, 32)
    for weight in network.processor.parameters():
        weight.requires_grad_(False)
    network(*graph).sum().backward()
    assert all(weight.grad is None for weight in network.processor.parameters())
    assert all(weight.grad is not None for weight in network.node_encoder.parameters())


@pytest.mark.parametrize("layers", [0, 1, 2, 5])
@pytest.mark.parametrize("kind", [{}, {"static_edges": True}])
def test_any_number_of_layers(layers: int, kind: dict[str, Any]) -> None:
    torch.manual_seed(0)
    network = EncodeProcessDecode(
        node_width=6,
        edge_width=4,
        output_width=3,
        latent_size=16,
        num_mlp_layers=1,
        num_message_passing_steps=layers,
        **kind,
    )
    graph = make_graph()
    torch.testing.assert_close(evaluate(network, *graph), plain(network, *graph), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("nodes", [0, 1, 7])
def test_few_nodes(nodes: int) -> None:
    network = make_network(1)
    graph = torch.ones(nodes, 6), torch.ones(0, 4), torch.zeros(2, 0, dtype=torch.int64)
    torch.testing.assert_close(evaluate(network, *graph), plain(network, *graph), atol=1e-5, rtol=1e-5)


def test_threads_give_the_same_bits() -> None:
    graph, network = make_graph(nodes=900, edges=20_000), make_network(1, 32)
    alone, threads = evaluate(network, *graph), torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        assert torch.equal(evaluate(network, *graph), alone)
    finally:
        torch.set_num_threads(threads)


def test_passes_of_other_sizes_leave_nothing_behind() -> None:
    network, small, large = make_network(1), make_graph(edges=30), make_graph(nodes=200, edges=3000)
    first = evaluate(network, *small)
    evaluate(network, *large)
    assert torch.equal(evaluate(network, *small), first)


def test_changed_weights_are_seen() -> None:
    """Changed in place, replaced, or in a copy that was trained on."""
    graph, network = make_graph(), make_network(1)
    before = evaluate(network, *graph)
    other = copy.deepcopy(network)
    with torch.no_grad():
        other.decoder[0].bias += 1.0
    assert torch.equal(evaluate(network, *graph), before) and not torch.equal(evaluate(other, *graph), before)
    network.processor[1].node_mlp[0] = nn.Linear(24, 12)
    assert not torch.equal(evaluate(network, *graph), before)
    torch.testing.assert_close(evaluate(network, *graph), plain(network, *graph), atol=1e-5, rtol=1e-5)


def test_what_it_does_not_know_it_leaves_to_torch() -> None:
    assert can_pack(make_network(1)) and not can_pack(make_network(1, 65))
    other = make_network(1)
    other.processor[0].edge_mlp[1] = nn.Tanh()
    assert not can_pack(other)
