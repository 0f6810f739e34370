"""Encode–process–decode (Sanchez-Gonzalez et al. 2020, section 3): features in, one vector per node out."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn

from gns_pl.nn.blocks import process_in_blocks
from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.mlp import mlp
from gns_pl.nn.packed import PackedNetwork, can_pack
from gns_pl.nn.packed_gradient import differentiable_pass
from gns_pl.nn.sorted_edges import SortedEdges
from gns_pl.nn.stack import LayerStack

FUSED_WIDTHS = (16, 32, 64, 128)
"""Latent sizes for which a block of edges fits into a GPU's registers."""


class EncodeProcessDecode(LayerStack):
    """Two encoders, a stack of unshared interaction networks, a decoder without norm.

    Args:
        node_width: width of the node features.
        edge_width: width of the edge features.
        output_width: width of the output.
        latent_size: width of the states.
        num_mlp_layers: hidden layers of each MLP.
        num_message_passing_steps: number of interaction networks.
        static_edges: every interaction network sees the encoded edges; else the edges it gets are those that the one
            before has updated.

    Attributes:
        compiled_edges: use the compiled loops of `nn.edges` where they can be used, float32 on the CPU, and the kernels
            of `nn.fused` on a GPU without gradients; edges sorted by receiver.
    """

    blocked = True
    sliceable = True

    @classmethod
    def fuses(cls, latent_size: int) -> bool:
        """Return whether `nn.fused` has kernels for this width, and Triton to compile them is there."""
        return latent_size in FUSED_WIDTHS and has_triton()

    def __init__(
        self,
        *,
        node_width: int,
        edge_width: int,
        output_width: int,
        latent_size: int,
        num_mlp_layers: int,
        num_message_passing_steps: int,
        static_edges: bool = False,
    ) -> None:
        super().__init__()
        self.node_encoder = mlp(node_width, latent_size, num_mlp_layers, latent_size, norm=True)
        self.edge_encoder = mlp(edge_width, latent_size, num_mlp_layers, latent_size, norm=True)
        self.processor = nn.ModuleList(
            InteractionNetwork(latent_size, num_mlp_layers) for _ in range(num_message_passing_steps)
        )
        self.decoder = mlp(latent_size, latent_size, num_mlp_layers, output_width, norm=False)
        self.static_edges = static_edges
        self.compiled_edges = True
        self._fused_key: tuple[object, ...] = ()
        self._fused_network: Callable[[Tensor, Tensor, Tensor], Tensor]
        self._packed_key: tuple[object, ...] = ()
        self._packed_network: PackedNetwork | None = None

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return the decoded nodes [N, output_width].

        Args:
            node: node features [N, F].
            edge: edge features [E, F'].
            edge_index: [2, E], sender and receiver.
        """
        plain = torch.compiler.is_exporting()  # compiled loops and kernels do not go into an exported program
        if node.device.type == "cuda" and not (plain or torch.is_grad_enabled()) and self._fuses(node, edge_index):
            return self._fused()(node, edge, edge_index)
        able = self.compiled_edges and node.device.type == "cpu" and node.dtype == torch.float32
        able = able and not (plain or torch.is_autocast_enabled("cpu"))
        sorted_edges = SortedEdges.of(edge_index, len(node)) if able else None
        if sorted_edges is not None and self.exchange is None and torch.is_grad_enabled():
            packed = self._packed()
            if packed is not None:
                return differentiable_pass(self, packed, node, edge, sorted_edges)
        if sorted_edges is not None and not torch.is_grad_enabled():
            packed = self._packed()
            if packed is not None:
                return packed(node, edge, sorted_edges, self.exchange)
            return process_in_blocks(self, node, edge, sorted_edges)
        node, edge = self.node_encoder(node), self.edge_encoder(edge)
        for layer in self.processor:
            last = self.static_edges or layer is self.processor[-1]
            node, updated = layer(node, edge, edge_index, sorted_edges, last=last)
            edge = edge if self.static_edges else updated
            if self.exchange is not None and layer is not self.processor[-1]:
                self.exchange(node)
        return cast(Tensor, self.decoder(node))

    def _fuses(self, node: Tensor, edge_index: Tensor) -> bool:
        """Return whether the kernels of `nn.fused` can make this pass."""
        width = cast(nn.Linear, self.decoder[0]).in_features
        able = self.compiled_edges and self.exchange is None and node.dtype == torch.float32
        if not (able and self.fuses(width) and edge_index.shape[1]):
            return False
        if torch.cuda.is_current_stream_capturing():
            return True  # whoever captures knows that they are sorted, and looking would wait
        return not bool((edge_index[1, 1:] < edge_index[1, :-1]).any())

    def _fused(self) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
        """Return the forward pass in kernels, for the weights as they are and torch's precision of products."""
        from gns_pl.nn.fused import FusedNetwork

        precision = "float32" if torch.get_float32_matmul_precision() == "highest" else "tf32"
        if torch.is_autocast_enabled("cuda"):
            precision = "bfloat16"
        key = self._state_key(precision)
        if key != self._fused_key:
            self._fused_key, self._fused_network = key, FusedNetwork(self, precision)
        return self._fused_network

    def _packed(self) -> PackedNetwork | None:
        """Return the forward pass in compiled loops, for the weights as they are; None where there is none."""
        key = self._state_key(str(self.static_edges))
        if key != self._packed_key:
            self._packed_key = key
            self._packed_network = PackedNetwork(self, self._packed_network) if can_pack(self) else None
        return self._packed_network

    def _state_key(self, setting: str) -> tuple[object, ...]:
        """Return what changes when the weights do, or are another network's."""
        weights = self.weights()
        places = [weight.data_ptr() for weight in weights]
        return id(self), setting, *places, *[0 if weight.is_inference() else weight._version for weight in weights]


@functools.cache
def has_triton() -> bool:
    """Return whether the language of the kernels is there."""
    return importlib.util.find_spec("triton") is not None
