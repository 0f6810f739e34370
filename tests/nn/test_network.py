"""A network by its name, registered or imported; and what every graph network of the house does to a graph."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.nn import EncodeProcessDecode, mlp, register_network
from gns_pl.nn.network import NETWORKS, Network, build_network, imported, network_class
from gns_pl.nn.precision import in_float32

SHAPE = {
    "node_width": 6,
    "edge_width": 4,
    "output_width": 3,
    "latent_size": 8,
    "num_mlp_layers": 1,
    "num_message_passing_steps": 2,
}
OWN = """
import torch
from gns_pl.nn.network import Network

class Sum(Network):
    def __init__(self, *, node_width, output_width, factor=1.0, **shape):
        super().__init__()
        self.factor, self.output_width = factor, output_width

    def forward(self, node, edge, edge_index):
        return self.factor * node.sum(dim=1, keepdim=True).expand(-1, self.output_width)

class Stranger:
    pass
"""


class Nothing(Network):
    """Zeros."""

    def __init__(self, *, output_width: int, **shape: int) -> None:
        super().__init__()
        self.output_width = output_width

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        return node.new_zeros(len(node), self.output_width)


@pytest.fixture
def registry() -> Iterator[None]:
    before = dict(NETWORKS)
    yield
    NETWORKS.clear()
    NETWORKS.update(before)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a network of one's own, in a module that no other test has imported."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / f"own_{tmp_path.name}.py").write_text(OWN)
    return tmp_path


def small(**changes: int) -> EncodeProcessDecode:
    torch.manual_seed(0)
    return EncodeProcessDecode(**(SHAPE | changes)).double()


def graph(nodes: int = 7, edges: int = 20, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Random features and edges, sorted by receiver."""
    generator = torch.Generator().manual_seed(seed)
    edge_index = torch.randint(0, nodes, (2, edges), generator=generator)
    edge_index = edge_index[:, torch.argsort(edge_index[1], stable=True)]
    node, edge = (
        torch.randn(number, width, generator=generator).double() for number, width in ((nodes, 6), (edges, 4))
    )
    return node, edge, edge_index


def test_a_registered_network_is_built_by_its_name(registry: None) -> None:
    assert register_network("nothing", Nothing) is Nothing
    assert network_class("nothing") is Nothing
    assert isinstance(build_network("nothing", **SHAPE), Nothing)
    assert network_class({"_target_": "nothing"}) is Nothing


def test_a_network_of_ones_own_folder_with_an_option(folder: Path) -> None:
    name = f"own_{folder.name}.Sum"
    network = build_network({"_target_": name, "factor": 3.0}, **SHAPE)
    assert isinstance(network, network_class(name))
    node, edge, edge_index = graph()
    torch.testing.assert_close(network(node, edge, edge_index), 3 * node.sum(dim=1, keepdim=True).expand(-1, 3))


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ("deeper", r"must be one of .*, or MODULE.CLASS of your own, not 'deeper'"),
        ("own_{}.Summ", r"has no attribute 'Summ'; it is looked for among packages and in "),
        ("no_such_module.Sum", r"No module named 'no_such_module'"),
        ("own_{}.Stranger", r"is no subclass of gns_pl.nn.network.Network"),
        ("own_{}.torch", r"is no subclass of"),
    ],
)
def test_what_is_no_network_is_refused(folder: Path, named: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        build_network(named.format(folder.name), **SHAPE)


def test_an_option_that_a_network_does_not_take_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match=r"model.network=EncodeProcessDecode: .*'depth'"):
        build_network({"_target_": "gns_pl.nn.EncodeProcessDecode", "depth": 3}, **SHAPE)


def test_looking_for_a_class_leaves_the_path_as_it_was(folder: Path) -> None:
    import sys

    before = list(sys.path)
    imported(f"own_{folder.name}.Sum", Network, "model.network", [])  # type: ignore[type-abstract]
    with pytest.raises(InputError):
        imported("no_such_module.Sum", Network, "model.network", [])  # type: ignore[type-abstract]
    assert sys.path == before


def test_a_network_that_says_nothing_can_nothing_but_a_pass() -> None:
    assert not (Nothing.blocked or Nothing.sliceable or Nothing.fuses(64)) and Nothing.exchange is None
    assert EncodeProcessDecode.blocked and EncodeProcessDecode.sliceable
    assert not EncodeProcessDecode.fuses(48)  # no kernel has this width


@pytest.mark.parametrize(("hidden", "layers", "norm"), [(5, 0, False), (5, 1, True), (16, 3, True)])
def test_an_mlp_has_as_many_weights_as_its_sizes_say(hidden: int, layers: int, norm: bool) -> None:
    sizes = [7, *[hidden] * layers, 3]
    expected = sum((before + 1) * after for before, after in itertools.pairwise(sizes)) + (2 * 3 if norm else 0)
    network = mlp(7, hidden, layers, 3, norm=norm)
    assert sum(weight.numel() for weight in network.parameters()) == expected
    assert sum(isinstance(layer, nn.ReLU) for layer in network) == layers


def test_a_normed_mlp_gives_numbers_of_order_one_whatever_goes_in() -> None:
    torch.manual_seed(0)
    output = mlp(7, 32, 2, 16, norm=True)(1e4 * torch.randn(50, 7))
    torch.testing.assert_close(output.mean(dim=1), torch.zeros(50), atol=1e-4, rtol=0)
    torch.testing.assert_close(output.var(dim=1, correction=0), torch.ones(50), atol=1e-3, rtol=0)


def test_two_graphs_side_by_side_are_two_graphs() -> None:
    network, (node, edge, edge_index), (other, others_edge, others_index) = small(), graph(), graph(4, 9, seed=1)
    joined = network(
        torch.cat([node, other]),
        torch.cat([edge, others_edge]),
        torch.cat([edge_index, others_index + len(node)], dim=1),
    )
    torch.testing.assert_close(joined[: len(node)], network(node, edge, edge_index))
    torch.testing.assert_close(joined[len(node) :], network(other, others_edge, others_index))


def test_the_order_of_edges_does_not_matter() -> None:
    network, (node, edge, edge_index) = small(), graph()
    order = torch.randperm(edge.shape[0], generator=torch.Generator().manual_seed(3))
    torch.testing.assert_close(network(node, edge[order], edge_index[:, order]), network(node, edge, edge_index))


def test_a_particle_that_nobody_reaches_sees_itself_alone() -> None:
    network, (node, edge, edge_index) = small(), graph()
    lonely = edge_index[1] != 2
    alone = network(node, edge[lonely], edge_index[:, lonely])[2]
    torch.testing.assert_close(alone, network(node[2:3], edge[:0], edge_index[:, :0])[0])


def test_gradients_are_those_of_differences() -> None:
    node, edge, edge_index = graph(3, 5)
    network = small(num_message_passing_steps=1)
    assert torch.autograd.gradcheck(
        lambda node, edge: network(node, edge, edge_index), (node.requires_grad_(), edge.requires_grad_())
    )


@pytest.mark.parametrize("gradients", [True, False])
@pytest.mark.parametrize("steps", [1, 2, 4])
def test_nodes_are_exchanged_between_layers_and_what_comes_is_used(steps: int, gradients: bool) -> None:
    """The last layer's states are nobody's business but the decoder's."""
    torch.manual_seed(0)
    network = EncodeProcessDecode(**(SHAPE | {"num_message_passing_steps": steps}))
    node, edge, edge_index = graph()
    node, edge = node.float(), edge.float()
    with torch.set_grad_enabled(gradients):
        alone = network(node, edge, edge_index).detach()
        seen: list[int] = []
        network.exchange = lambda states: seen.append(len(states))
        torch.testing.assert_close(network(node, edge, edge_index).detach(), alone)
        assert seen == [len(node)] * (steps - 1)
    with torch.no_grad():
        network.exchange = None
        alone = network(node, edge, edge_index)
        network.exchange = lambda states: states.zero_()
        assert torch.equal(network(node, edge, edge_index), alone) == (steps == 1)


def test_networks_are_single_precision_in_a_double_precision_program() -> None:
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        assert in_float32(small_linear)().weight.dtype == torch.float32
        assert torch.get_default_dtype() == torch.float64
        with pytest.raises(ZeroDivisionError):
            in_float32(lambda: 1 / 0)()
        assert torch.get_default_dtype() == torch.float64
    finally:
        torch.set_default_dtype(before)


def small_linear() -> nn.Linear:
    """A layer."""
    return nn.Linear(2, 2)
