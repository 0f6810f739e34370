"""One message-passing layer: an interaction network (Battaglia et al. 2016) on PyG's `MessagePassing`."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn
from torch_geometric.nn import MessagePassing

from gns_pl.nn.edges import gather_and_rectify, norm_and_sum
from gns_pl.nn.mlp import mlp
from gns_pl.nn.sorted_edges import SortedEdges


class InteractionNetwork(MessagePassing):  # type: ignore[misc]
    """Messages from edges and both ends, summed at the receiver, with residual edge and node updates.

    | equation | code |
    |---|---|
    | m_ij = MLP_e([x_j, x_i, e_ij]) | `message`, first layer split: W [x_j, x_i, e] = W_s x_j + W_r x_i + W_e e |
    | e_ij ← e_ij + m_ij | `forward` |
    | x_i ← x_i + MLP_n([Σ_j m_ij, x_i]) | `forward` |

    The split multiplies the N nodes instead of the E edges by two thirds of the first layer.

    Args:
        latent_size: width of node and edge states.
        num_mlp_layers: hidden layers of each MLP, at least one.
    """

    def __init__(self, latent_size: int, num_mlp_layers: int) -> None:
        super().__init__(aggr="sum", flow="source_to_target")
        self.sender = nn.Linear(latent_size, latent_size, bias=False)
        self.receiver = nn.Linear(latent_size, latent_size, bias=False)
        self.edge_mlp = mlp(latent_size, latent_size, num_mlp_layers, latent_size, norm=True)
        self.node_mlp = mlp(2 * latent_size, latent_size, num_mlp_layers, latent_size, norm=True)
        # Together the three parts start as one layer of three times the width would.
        with torch.no_grad():
            for weight in (self.sender.weight, self.receiver.weight, self.edge_mlp.get_parameter("0.weight")):
                weight.mul_(3**-0.5)

    def forward(
        self,
        node: Tensor,
        edge: Tensor,
        edge_index: Tensor,
        sorted_edges: SortedEdges | None = None,
        last: bool = False,
    ) -> tuple[Tensor, Tensor]:
        """Return the new node [N, L] and edge states [E, L].

        Args:
            node: [N, L].
            edge: [E, L].
            edge_index: [2, E], sender and receiver.
            sorted_edges: the same edges for the compiled loops (`nn.edges`); None for PyG's way.
            last: the new edge states are not needed; they may come back empty.
        """
        sending, receiving = self.sender(node), self.receiver(node)
        if sorted_edges is None:
            message = self.edge_updater(edge_index, sender=sending, receiver=receiving, edge=edge)
            received = self.propagate(edge_index, message=message, size=(len(node), len(node)))
            updated = edge + message
        else:
            first, rest, norm = self.edge_mlp[0], self.edge_mlp[2:-1], cast(nn.LayerNorm, self.edge_mlp[-1])
            value = rest(gather_and_rectify(first(edge), sending, receiving, sorted_edges))
            updated, received = norm_and_sum(value, norm, edge, sorted_edges, keep=not last)
        return node + self.node_mlp(torch.cat([received, node], dim=1)), updated

    def edge_update(self, sender_j: Tensor, receiver_i: Tensor, edge: Tensor) -> Tensor:
        """Return the messages [E, L]."""
        first, rest = self.edge_mlp[0], self.edge_mlp[1:]
        message: Tensor = rest(first(edge) + sender_j + receiver_i)
        return message

    def message(self, message: Tensor) -> Tensor:
        """Return what is gathered at the receiver [E, L]."""
        return message
