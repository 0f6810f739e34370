"""The first layer as the papers write it, for the plain references of the benchmarks."""

import torch
from torch import nn

from gns_pl.nn.interaction_network import InteractionNetwork


def concatenated_mlp(layer: InteractionNetwork) -> nn.Sequential:
    """Return a layer's edge MLP, with its weights, for [sender, receiver, edge] concatenated [E, 3 L]."""
    parts = (layer.sender.weight, layer.receiver.weight, layer.edge_mlp[0].weight)
    whole = nn.Linear(3 * parts[0].shape[1], parts[0].shape[0])
    with torch.no_grad():
        whole.weight.copy_(torch.cat(parts, dim=1))
        whole.bias.copy_(layer.edge_mlp[0].bias)
    return nn.Sequential(whole, *layer.edge_mlp[1:])
