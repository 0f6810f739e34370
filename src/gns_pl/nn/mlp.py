"""The multilayer perceptron every block of the network is made of."""

from __future__ import annotations

import itertools

from torch import nn


def mlp(input_size: int, hidden_size: int, num_hidden_layers: int, output_size: int, *, norm: bool) -> nn.Sequential:
    """Return Linear–ReLU blocks, a last Linear, and a LayerNorm if `norm`.

    Args:
        input_size: width of the input.
        hidden_size: width of the hidden layers.
        num_hidden_layers: how many there are.
        output_size: width of the output.
        norm: end with a LayerNorm, as all but the decoder do.
    """
    sizes = [input_size, *[hidden_size] * num_hidden_layers, output_size]
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(sizes):
        layers += [nn.Linear(before, after), nn.ReLU()]
    layers.pop()
    if norm:
        layers.append(nn.LayerNorm(output_size))
    return nn.Sequential(*layers)
