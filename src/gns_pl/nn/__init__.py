"""The networks: multilayer perceptron, interaction network, encode–process–decode. Graph in, numbers out; no units."""

from gns_pl.nn.encode_process_decode import EncodeProcessDecode
from gns_pl.nn.interaction_network import InteractionNetwork
from gns_pl.nn.mlp import mlp
from gns_pl.nn.precision import in_float32

__all__ = ["EncodeProcessDecode", "InteractionNetwork", "in_float32", "mlp"]
