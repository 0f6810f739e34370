"""What a network is to the rest: features of a graph in, one vector per node out. Its own or anybody's, by name.

A network of one's own is a class below `Network`, in any file that Python finds from the working folder; nothing here
has to be edited for it (docs/extend.md).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.extensions import imported


class Network(nn.Module):
    """Node and edge features of a graph → one vector per node.

    A subclass takes `node_width`, `edge_width`, `output_width`, `latent_size`, `num_mlp_layers` and
    `num_message_passing_steps` as keywords, and options of its own besides. The class says what it can besides a plain
    pass, and whoever wants more asks.

    Attributes:
        blocked: on a CPU without gradients it keeps no edge-sized arrays but its edge states (`nn.blocks`).
        sliceable: it calls `exchange` between layers, so that several processes can share its edges out.
        exchange: called with the node states [N, L] after every layer but the last; it may overwrite rows, as those
            that another process has computed. None where there is nobody to exchange with.
    """

    exchange: Callable[[Tensor], None] | None = None
    blocked: ClassVar[bool] = False
    sliceable: ClassVar[bool] = False

    @classmethod
    def fuses(cls, latent_size: int) -> bool:
        """Return whether its pass consists of kernels that a CUDA graph can capture, at this width of the states."""
        return False

    @abstractmethod
    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return outputs of nodes [N, output_width].

        Args:
            node: node features [N, F].
            edge: edge features [E, F'].
            edge_index: [2, E], sender and receiver, sorted by receiver.
        """


NETWORKS: dict[str, type[Network]] = {}
"""Name → class; `register_network` adds."""


def register_network(name: str, network: type[Network]) -> type[Network]:
    """Make a network known by a name, and return it."""
    NETWORKS[name] = network
    return network


def network_class(network: str | Mapping[str, Any]) -> type[Network]:
    """Return the class of a network: a registered name, "module.Class", or a mapping with "_target_", either of both.

    Raises:
        InputError: there is none, or it is no `Network`.
    """
    name = str(network if isinstance(network, str) else network.get("_target_", ""))
    if name in NETWORKS:
        return NETWORKS[name]
    return imported(name, Network, "model.network", sorted(NETWORKS))  # type: ignore[type-abstract]


def build_network(network: str | Mapping[str, Any], **shape: int) -> Network:
    """Return a network with random weights.

    Args:
        network: as of `network_class`; further keys of a mapping are options of its constructor.
        shape: widths and layers, as `Network` says.

    Raises:
        InputError: no such network, or options that it does not take.
    """
    options = {} if isinstance(network, str) else {key: value for key, value in network.items() if key != "_target_"}
    kind = network_class(network)
    try:
        return kind(**shape, **options)
    except TypeError as error:
        raise InputError(f"model.network={kind.__name__}: {error}.") from error
