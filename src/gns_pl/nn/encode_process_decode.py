"""Encode–process–decode (Sanchez-Gonzalez et al. 2020, section 3): features in, one vector per node out."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn

from gns_pl.nn.blocks import process_in_blocks
from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.mlp import mlp
from gns_pl.nn.sorted_edges import SortedEdges


class EncodeProcessDecode(nn.Module):
    """Two encoders, a stack of unshared interaction networks, a decoder without norm.

    Args:
        node_width: width of the node features.
        edge_width: width of the edge features.
        output_width: width of the output.
        latent_size: width of the states.
        num_mlp_layers: hidden layers of each MLP.
        num_message_passing_steps: number of interaction networks.
        aggregation: of the messages at a node, "sum" or "mean".
        static_edges: every interaction network sees the encoded edges; else the edges it gets are those that the one
            before has updated.

    Attributes:
        compiled_edges: use the compiled loops of `nn.edges` where they can be used: float32 on the CPU, edges sorted
            by receiver.
        exchange: called with the node states [N, L] after every interaction network but the last; it may overwrite
            rows, as those that another process has computed. None where there is nobody to exchange with.
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
        aggregation: str = "sum",
        static_edges: bool = False,
    ) -> None:
        super().__init__()
        self.node_encoder = mlp(node_width, latent_size, num_mlp_layers, latent_size, norm=True)
        self.edge_encoder = mlp(edge_width, latent_size, num_mlp_layers, latent_size, norm=True)
        self.processor = nn.ModuleList(
            InteractionNetwork(latent_size, num_mlp_layers, aggregation) for _ in range(num_message_passing_steps)
        )
        self.decoder = mlp(latent_size, latent_size, num_mlp_layers, output_width, norm=False)
        self.static_edges = static_edges
        self.compiled_edges = True
        self.exchange: Callable[[Tensor], None] | None = None

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return the decoded nodes [N, output_width].

        Args:
            node: node features [N, F].
            edge: edge features [E, F'].
            edge_index: [2, E], sender and receiver.
        """
        able = self.compiled_edges and node.device.type == "cpu" and node.dtype == torch.float32
        able = able and not torch.is_autocast_enabled("cpu")
        sorted_edges = SortedEdges.of(edge_index, len(node)) if able else None
        if sorted_edges is not None and not torch.is_grad_enabled():
            return process_in_blocks(self, node, edge, sorted_edges)
        node, edge = self.node_encoder(node), self.edge_encoder(edge)
        for layer in self.processor:
            last = self.static_edges or layer is self.processor[-1]
            node, updated = layer(node, edge, edge_index, sorted_edges, last=last)
            edge = edge if self.static_edges else updated
            if self.exchange is not None and layer is not self.processor[-1]:
                self.exchange(node)
        return cast(Tensor, self.decoder(node))
