"""From positions to a graph: exact neighbours, node and edge features with their widths, and training noise.

Plain tensors in, plain tensors out; no learned parameter and no file lives here.
"""

from gns_pl.graph.columns import ColumnMeans
from gns_pl.graph.context import context_bytes
from gns_pl.graph.features import SceneBatch, edge_features, edge_width, node_features, node_width
from gns_pl.graph.neighbours import BACKENDS, NUMBA, radius_graph
from gns_pl.graph.noise import coherent_noise, random_walk_noise
from gns_pl.graph.reuse import NeighbourList
from gns_pl.graph.surfaces import Surfaces
from gns_pl.graph.training_distribution import TrainingDistribution, surroundings
from gns_pl.graph.window_random import WindowRandom

__all__ = [
    "BACKENDS",
    "NUMBA",
    "ColumnMeans",
    "NeighbourList",
    "SceneBatch",
    "Surfaces",
    "TrainingDistribution",
    "WindowRandom",
    "coherent_noise",
    "context_bytes",
    "edge_features",
    "edge_width",
    "node_features",
    "node_width",
    "radius_graph",
    "random_walk_noise",
    "surroundings",
]
