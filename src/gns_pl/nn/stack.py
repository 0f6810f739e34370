"""The layers of an encode–process–decode network, without the way in which a pass through them is made."""

from __future__ import annotations

from torch import Tensor, nn

from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.network import Network


class LayerStack(Network):
    """What `nn.blocks` and `nn.fused` evaluate.

    Attributes:
        node_encoder: [N, F] → [N, L].
        edge_encoder: [E, F'] → [E, L].
        processor: interaction networks.
        decoder: [N, L] → [N, O], without a norm.
        static_edges: every interaction network sees the encoded edges; else the edges it gets are those that the one
            before has updated.
    """

    node_encoder: nn.Sequential
    edge_encoder: nn.Sequential
    decoder: nn.Sequential
    static_edges: bool

    @property
    def layers(self) -> list[InteractionNetwork]:
        """The interaction networks, in their order."""
        return list(self.processor)  # type: ignore[arg-type]

    def weights(self) -> list[Tensor]:
        """Return all weights; `parameters()` makes names besides, and takes ten times as long."""
        modules: list[nn.Module] = [self]
        found: list[nn.Parameter | None] = []
        for module in modules:  # grows
            modules.extend(inner for inner in module._modules.values() if inner is not None)
            found.extend(module._parameters.values())
        return [weight for weight in found if weight is not None]
