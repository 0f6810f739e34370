"""One message-passing layer: an interaction network (Battaglia et al. 2016) on PyG's `MessagePassing`."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch_geometric.nn import MessagePassing

from gns_pl.nn.mlp import mlp


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
        num_mlp_layers: hidden layers of each MLP.
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

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> tuple[Tensor, Tensor]:
        """Return the new node [N, L] and edge states [E, L].

        Args:
            node: [N, L].
            edge: [E, L].
            edge_index: [2, E], sender and receiver.
        """
        message = self.edge_updater(edge_index, sender=self.sender(node), receiver=self.receiver(node), edge=edge)
        received = self.propagate(edge_index, message=message, size=(len(node), len(node)))
        return node + self.node_mlp(torch.cat([received, node], dim=1)), edge + message

    def edge_update(self, sender_j: Tensor, receiver_i: Tensor, edge: Tensor) -> Tensor:
        """Return the messages [E, L]."""
        first, rest = self.edge_mlp[0], self.edge_mlp[1:]
        message: Tensor = rest(first(edge) + sender_j + receiver_i)
        return message

    def message(self, message: Tensor) -> Tensor:
        """Return what is summed at the receiver [E, L]."""
        return message
