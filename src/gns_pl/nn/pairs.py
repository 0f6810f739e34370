"""Half of the edges: one message for both particles of a pair, of opposite sign, so that Newton's third law holds.

What a message is made of is even (the same seen from both ends) or odd (of opposite sign). An MLP of the even part
times a linear map of the odd part is odd whatever the weights are; sums of odd messages over all particles vanish.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from gns_pl.nn.mlp import mlp


class PairInteraction(nn.Module):
    """An interaction network (Battaglia et al. 2016) with one antisymmetric message per pair.

    | equation | code |
    |---|---|
    | h_ij = MLP_e([x_i + x_j, e_ij]), even | `pair_mlp`, its first layer split as in `InteractionNetwork` |
    | m_ij = h_ij ⊙ (W (x_j − x_i) + V d_ij), odd | `difference`, `displacement` |
    | e_ij ← e_ij + h_ij | |
    | x_i ← x_i + MLP_n([Σ_j m_ij, x_i]) | received with + at i and − at j |

    Args:
        latent_size: width L of node and pair states.
        num_mlp_layers: hidden layers of each MLP, at least one.
        odd_width: width of what is odd of a pair.
    """

    def __init__(self, latent_size: int, num_mlp_layers: int, odd_width: int) -> None:
        super().__init__()
        self.ends = nn.Linear(latent_size, latent_size, bias=False)
        self.pair_mlp = mlp(latent_size, latent_size, num_mlp_layers, latent_size, norm=True)
        self.difference = nn.Linear(latent_size, latent_size, bias=False)
        self.displacement = nn.Linear(odd_width, latent_size, bias=False)
        self.node_mlp = mlp(2 * latent_size, latent_size, num_mlp_layers, latent_size, norm=True)

    def forward(self, node: Tensor, pair: Tensor, odd: Tensor, ends: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the new node [N, L] and pair states [P, L], and the messages to the first ends [P, L].

        Args:
            node: [N, L].
            pair: even states [P, L].
            odd: what changes its sign when the ends are exchanged [P, O].
            ends: the two particles of each pair [2, P].
        """
        first, second = ends
        even, opposed = self.ends(node), self.difference(node)
        hidden = self.pair_mlp[0](pair) + even[first] + even[second]
        value: Tensor = self.pair_mlp[1:](hidden)
        message = value * (opposed[second] - opposed[first] + self.displacement(odd))
        received = opposed_sums(message, ends, len(node))
        return node + self.node_mlp(torch.cat([received, node], dim=1)), pair + value, message


class PairNetwork(nn.Module):
    """Encode, process and decode with one message per pair; forces of pairs are antisymmetric, those of walls are not.

    Takes what `EncodeProcessDecode` takes. Of its two outputs the first sums to zero over the nodes of every graph, the
    second is a node's own.

    Args:
        node_width: width of the node features.
        edge_width: width of the edge features, an odd displacement and its length.
        output_width: of both outputs together, even.
        latent_size: width of the states.
        num_mlp_layers: hidden layers of each MLP.
        num_message_passing_steps: number of interactions, at least one.
    """

    def __init__(
        self,
        *,
        node_width: int,
        edge_width: int,
        output_width: int,
        latent_size: int,
        num_mlp_layers: int,
        num_message_passing_steps: int,
    ) -> None:
        super().__init__()
        dim = edge_width - 1
        self.node_encoder = mlp(node_width, latent_size, num_mlp_layers, latent_size, norm=True)
        self.pair_encoder = mlp(1 + dim * (dim + 1) // 2, latent_size, num_mlp_layers, latent_size, norm=True)
        self.processor = nn.ModuleList(
            PairInteraction(latent_size, num_mlp_layers, dim) for _ in range(num_message_passing_steps)
        )
        self.force = nn.Linear(latent_size, output_width // 2, bias=False)
        self.decoder = mlp(latent_size, latent_size, num_mlp_layers, output_width // 2, norm=False)

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return the sums of the pairs' forces and the nodes' own outputs side by side [N, output_width].

        Args:
            node: node features [N, F].
            edge: displacement from receiver to sender, and its length [E, D + 1].
            edge_index: [2, E], sender and receiver; both directions of every pair.
        """
        half = edge_index[1] < edge_index[0]
        second, first = edge_index[:, half]
        ends = torch.stack([first, second])
        odd, length = edge[half, :-1], edge[half, -1:]
        rows, columns = torch.triu_indices(odd.shape[1], odd.shape[1])
        products = odd[:, rows] * odd[:, columns] / length.square().clamp(min=1e-12)
        node, pair = self.node_encoder(node), self.pair_encoder(torch.cat([length, products], dim=1))
        message = node.new_zeros(len(odd), node.shape[1])
        for layer in self.processor:
            node, pair, message = layer(node, pair, odd, ends)
        forces = opposed_sums(cast(Tensor, self.force(message)), ends, len(node))
        return torch.cat([forces, self.decoder(node)], dim=1)


def opposed_sums(value: Tensor, ends: Tensor, num_nodes: int) -> Tensor:
    """Return the sums at the nodes of what pairs give to their first ends and take from their second [N, L].

    Args:
        value: of the pairs [P, L].
        ends: [2, P].
        num_nodes: N.
    """
    return value.new_zeros(num_nodes, value.shape[1]).index_add(0, ends[0], value).index_add(0, ends[1], -value)
