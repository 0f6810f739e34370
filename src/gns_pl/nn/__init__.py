"""The networks: multilayer perceptron, interaction network, encode–process–decode. Graph in, numbers out; no units."""

from gns_pl.nn.encode_process_decode import EncodeProcessDecode
from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.mlp import mlp
from gns_pl.nn.pairs import PairNetwork

__all__ = ["EncodeProcessDecode", "InteractionNetwork", "PairNetwork", "mlp"]
