"""The networks: multilayer perceptron, interaction network, encode–process–decode. Graph in, numbers out; no units."""

from gns_pl.nn.encode_process_decode import EncodeProcessDecode
from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.mlp import mlp
from gns_pl.nn.network import NETWORKS, Network, build_network, network_class, register_network
from gns_pl.nn.precision import in_float32

DEFAULT_NETWORK = "encode_process_decode"
"""Name of the network that a model has without another word."""

register_network(DEFAULT_NETWORK, EncodeProcessDecode)

__all__ = [
    "DEFAULT_NETWORK",
    "NETWORKS",
    "EncodeProcessDecode",
    "InteractionNetwork",
    "Network",
    "build_network",
    "in_float32",
    "mlp",
    "network_class",
    "register_network",
]
