"""Messages of pairs against the plain formula, and what exchanging the ends of a pair must not change."""

from __future__ import annotations

import torch

from gns_pl.nn import PairNetwork
from gns_pl.nn.pairs import PairInteraction


def make_network() -> PairNetwork:
    torch.manual_seed(0)
    return PairNetwork(
        node_width=5, edge_width=4, output_width=6, latent_size=8, num_mlp_layers=1, num_message_passing_steps=2
    ).double()


def make_graph(number: int = 7) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Nodes, and every pair of them in both directions."""
    position = torch.randn(number, 3).double()
    index = torch.combinations(torch.arange(number)).T
    edge_index = torch.cat([index, index.flip(0)], dim=1)
    displacement = position[edge_index[0]] - position[edge_index[1]]
    edge = torch.cat([displacement, displacement.norm(dim=1, keepdim=True)], dim=1)
    return torch.randn(number, 5).double(), edge, edge_index


def test_an_interaction_equals_its_formula() -> None:
    torch.manual_seed(0)
    layer = PairInteraction(8, 2, 3).double()
    node, pair, odd = torch.randn(5, 8).double(), torch.randn(6, 8).double(), torch.randn(6, 3).double()
    ends = torch.tensor([[0, 1, 2, 0, 3, 1], [1, 2, 3, 4, 4, 3]])
    received, states = torch.zeros(5, 8).double(), []
    for p, (i, j) in enumerate(ends.T.tolist()):
        first = layer.ends.weight @ (node[i] + node[j]) + layer.pair_mlp[0](pair[p])
        even = layer.pair_mlp[1:](first[None])[0]
        message = even * (layer.difference.weight @ (node[j] - node[i]) + layer.displacement.weight @ odd[p])
        received[i] += message
        received[j] -= message
        states.append(pair[p] + even)
    new_node, new_pair, _ = layer(node, pair, odd, ends)
    torch.testing.assert_close(new_node, node + layer.node_mlp(torch.cat([received, node], dim=1)))
    torch.testing.assert_close(new_pair, torch.stack(states))


def test_forces_sum_to_zero_and_the_order_of_particles_does_not_matter() -> None:
    network, (node, edge, edge_index) = make_network(), make_graph()
    output = network(node, edge, edge_index)
    assert output[:, :3].sum(dim=0).abs().max() < 1e-13 < 1e-3 < output[:, :3].abs().min()
    order = torch.randperm(len(node))  # other particles are now the first ends of their pairs
    place = torch.argsort(order)
    torch.testing.assert_close(network(node[order], edge, place[edge_index]), output[order])


def test_two_particles_are_pushed_apart_or_together_with_equal_forces() -> None:
    network = make_network()
    node, edge, edge_index = make_graph(2)
    first, second = network(node, edge, edge_index)[:, :3]
    torch.testing.assert_close(first, -second)
