"""The layers of an encode–process–decode network, without the way in which a pass through them is made."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor, nn

from gns_pl.nn.interaction_network import InteractionNetwork


class LayerStack(nn.Module):
    """What `nn.blocks` and `nn.fused` evaluate.

    Attributes:
        node_encoder: [N, F] → [N, L].
        edge_encoder: [E, F'] → [E, L].
        processor: interaction networks.
        decoder: [N, L] → [N, O], without a norm.
        static_edges: every interaction network sees the encoded edges; else the edges it gets are those that the one
            before has updated.
        exchange: called with the node states [N, L] after every interaction network but the last; it may overwrite
            rows, as those that another process has computed. None where there is nobody to exchange with.
    """

    node_encoder: nn.Sequential
    edge_encoder: nn.Sequential
    decoder: nn.Sequential
    static_edges: bool
    exchange: Callable[[Tensor], None] | None

    def __init__(self) -> None:
        super().__init__()
        self.exchange = None

    @property
    def layers(self) -> list[InteractionNetwork]:
        """The interaction networks, in their order."""
        return list(self.processor)  # type: ignore[arg-type]
