"""What makes a step faster without touching the network: each a wrapper that can be had alone.

Positions, their differences and the integration stay in float32 whatever the network computes in.
"""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.graph import NeighbourList
from gns_pl.nn import EncodeProcessDecode
from gns_pl.simulator import Simulator

PRECISIONS = ("float32", "tf32", "bfloat16")

EDGE_BUDGET = 8192
"""A compiled network sees numbers of edges that are multiples of this, so that it is compiled for few of them."""


def accelerate(
    simulator: Simulator, *, skin: float = 0.0, precision: str = "float32", compiled: bool = False
) -> Simulator:
    """Return a simulator with the same weights that makes the same steps in another way.

    Args:
        simulator: stays as it is.
        skin: neighbours are searched again when a particle has moved half of so many connectivity radii; 0: each step.
        precision: of the network's products; for GPUs. "bfloat16" changes accelerations by up to 4 % of their root
            mean square, "tf32" by less.
        compiled: by `torch.compile`, on CUDA with its graphs; the first steps take up to minutes.

    Raises:
        InputError: a negative skin, or an unknown precision.
    """
    if not skin >= 0:
        raise InputError(f"acceleration.skin must be 0 or more connectivity radii, not {skin}.")
    if precision not in PRECISIONS:
        raise InputError(f"acceleration.precision must be one of {', '.join(PRECISIONS)}, not {precision!r}.")
    fast = copy.copy(simulator)
    fast._modules = dict(simulator._modules)  # else it would share the table of modules, and the other's network change
    if skin:
        fast.search = NeighbourList(skin)
    network = cast(nn.Module, simulator.network)
    if compiled:
        network = Padded(_compile(network), EDGE_BUDGET)
    if precision != "float32":
        network = InPrecision(network, precision)
    fast._modules["network"] = network
    return fast


def _compile(network: nn.Module) -> nn.Module:
    network = cast(EncodeProcessDecode, copy.copy(network))  # shares the weights
    network.compiled_edges = False  # torch.compile fuses on its own, and cannot look into ours
    mode = "reduce-overhead" if next(network.parameters()).device.type == "cuda" else "default"
    return cast(nn.Module, torch.compile(network, dynamic=False, mode=mode))


class Padded(nn.Module):
    """A network that gets one node and some edges more, so that shapes repeat; the edges join that node to itself.

    Args:
        network: as `EncodeProcessDecode`.
        budget: numbers of edges are rounded up to a multiple.
    """

    def __init__(self, network: nn.Module, budget: int) -> None:
        super().__init__()
        self.network, self.budget = network, budget

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return what the network gives for the nodes that there are; arguments as the network's."""
        missing = -len(edge) % self.budget
        node = torch.cat([node, node.new_zeros(1, node.shape[1])])
        edge = torch.cat([edge, edge.new_zeros(missing, edge.shape[1])])
        edge_index = torch.cat([edge_index, edge_index.new_full((2, missing), len(node) - 1)], dim=1)
        output: Tensor = self.network(node, edge, edge_index)
        return output[:-1].clone()  # a CUDA graph writes its next output over this one


class InPrecision(nn.Module):
    """A network whose products are made in less than float32; what goes in and comes out is float32.

    Args:
        network: as `EncodeProcessDecode`.
        precision: "tf32" or "bfloat16".
    """

    def __init__(self, network: nn.Module, precision: str) -> None:
        super().__init__()
        self.network, self.precision = network, precision

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return what the network gives; arguments as the network's."""
        if self.precision == "bfloat16":
            with torch.autocast(node.device.type, dtype=torch.bfloat16):
                return cast(Tensor, self.network(node, edge, edge_index)).float()
        before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision("high")
        try:
            return cast(Tensor, self.network(node, edge, edge_index))
        finally:
            torch.set_float32_matmul_precision(before)
