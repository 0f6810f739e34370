"""The interaction network against its plain formula, and what any graph network must respect."""

from __future__ import annotations

from typing import Any

import torch

from gns_pl.nn import EncodeProcessDecode, InteractionNetwork, mlp


def test_mlp_has_the_papers_shape() -> None:
    kinds = [type(layer).__name__ for layer in mlp(7, 128, 2, 128, norm=True)]
    assert kinds == ["Linear", "ReLU", "Linear", "ReLU", "Linear", "LayerNorm"]
    assert type(mlp(7, 128, 2, 3, norm=False)[-1]).__name__ == "Linear"


def test_interaction_network_equals_its_formula() -> None:
    torch.manual_seed(0)
    layer = InteractionNetwork(8, 2).double()
    node, edge = torch.randn(5, 8).double(), torch.randn(9, 8).double()
    edge_index = torch.randint(0, 5, (2, 9))
    weight = torch.cat([layer.sender.weight, layer.receiver.weight, layer.edge_mlp[0].weight], dim=1)
    message = torch.cat([node[edge_index[0]], node[edge_index[1]], edge], dim=1) @ weight.T + layer.edge_mlp[0].bias
    message = layer.edge_mlp[1:](message)
    received = torch.stack([message[edge_index[1] == i].sum(dim=0) for i in range(5)])
    new_node, new_edge = layer(node, edge, edge_index)
    torch.testing.assert_close(new_node, node + layer.node_mlp(torch.cat([received, node], dim=1)))
    torch.testing.assert_close(new_edge, edge + message)


def test_permuting_particles_permutes_the_output() -> None:
    torch.manual_seed(0)
    network = EncodeProcessDecode(
        node_width=6, edge_width=4, output_width=3, latent_size=8, num_mlp_layers=1, num_message_passing_steps=3
    ).double()
    node, edge, edge_index = torch.randn(6, 6).double(), torch.randn(12, 4).double(), torch.randint(0, 6, (2, 12))
    order = torch.randperm(6)
    place = torch.argsort(order)
    permuted = network(node[order], edge, place[edge_index])
    torch.testing.assert_close(permuted, network(node, edge, edge_index)[order])


def test_information_travels_one_edge_per_step() -> None:
    torch.manual_seed(0)
    chain = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4]])
    for steps in (1, 2, 4):
        network = EncodeProcessDecode(
            node_width=2,
            edge_width=1,
            output_width=1,
            latent_size=8,
            num_mlp_layers=1,
            num_message_passing_steps=steps,
        )
        node = torch.zeros(5, 2)
        changed = node.clone()
        changed[0] += 1
        edge = torch.zeros(4, 1)
        touched = (network(node, edge, chain) != network(changed, edge, chain)).flatten().tolist()
        assert touched == [index <= steps for index in range(5)]


def layered(**kind: Any) -> EncodeProcessDecode:
    torch.manual_seed(0)
    return EncodeProcessDecode(
        node_width=6, edge_width=4, output_width=3, latent_size=8, num_mlp_layers=1, num_message_passing_steps=2, **kind
    ).double()


def test_static_edges_stay_as_they_were_encoded() -> None:
    node, edge, edge_index = torch.randn(6, 6).double(), torch.randn(12, 4).double(), torch.randint(0, 6, (2, 12))
    network = layered(static_edges=True)
    state, encoded = network.node_encoder(node), network.edge_encoder(edge)
    for layer in network.processor:
        state, _ = layer(state, encoded, edge_index)
    torch.testing.assert_close(network(node, edge, edge_index), network.decoder(state))
    assert not torch.allclose(layered()(node, edge, edge_index), network(node, edge, edge_index))
