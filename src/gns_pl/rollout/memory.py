"""How much memory a step takes, before it is tried."""

from __future__ import annotations

import math

import torch

from gns_pl.errors import InputError
from gns_pl.graph import context_bytes, radius_graph
from gns_pl.machine import free_memory
from gns_pl.models.config import SimulatorConfig
from gns_pl.nn import network_class
from gns_pl.nn.packed import ROOM
from gns_pl.nn.packed_layout import padded_width
from gns_pl.rollout.engine import Run, history_of
from gns_pl.rollout.static import static_of
from gns_pl.rollout.stepper import Stepper

HEADROOM = 1.2
"""More edges than at the start: a heap is denser than a body at rest before it falls."""


def estimate_bytes(
    config: SimulatorConfig,
    num_particles: int,
    num_edges: int,
    *,
    in_blocks: bool,
    nodes: int = 0,
    boxes: int = 1,
    share: float = 1.0,
) -> int:
    """Return the most bytes that a step of the simulator holds at once, the history included.

    Args:
        config: of the simulator.
        num_particles: N.
        num_edges: E.
        in_blocks: on the CPU in float32, where messages go through `nn.packed` or `nn.blocks`; else every layer keeps
            E × L numbers several times.
        nodes: of the context's grid over one box, where the simulator has a context.
        boxes: scenes that are stepped together.
        share: of edges and states that this memory holds; the context's grid is in every process.
    """
    dim, width = config.dim, config.latent_size
    node = 4 * num_particles * (config.input_sequence_length * dim * 3 + 12)
    context = context_bytes(nodes, boxes, num_particles, dim, compiled=in_blocks) if config.context else 0
    features = num_edges * (16 + 4 * (dim + 1))
    making_features = features + 4 * num_edges * (3 * dim + 1)
    layers = config.num_message_passing_steps
    if in_blocks:
        states = 4 * ROOM * padded_width(width) * (num_edges * (layers > 1) + 4 * num_particles)
    else:
        states = 4 * width * (6 * num_edges + 8 * num_particles)
    searched = context + share * num_edges * 16
    return int(max(node + searched, share * (node + max(making_features, features + states))))


def check_memory(stepper: Stepper, runs: list[Run], share: float = 1.0) -> str:
    """Return in words what the steps of scenes need and what there is.

    Args:
        stepper: makes the steps.
        runs: the scenes.
        share: of edges and states that this memory holds, where several processes share a run.

    Raises:
        InputError: less is free than is needed.
    """
    config, device = stepper.config, stepper.device
    scenes = static_of(*(run.start for run in runs))
    position = torch.cat([history_of(run, config)[:, -1] for run in runs])
    radius, graphs = config.connectivity_radius, scenes.num_graphs
    edges = radius_graph(position, radius, scenes.batch, backend=config.neighbours, num_graphs=graphs).shape[1]
    blocks = device.type == "cpu" and network_class(config.network).blocked
    nodes = math.prod(scenes.grid(radius).shape) if config.context else 0
    needed = estimate_bytes(
        config, len(position), int(HEADROOM * edges), in_blocks=blocks, nodes=nodes, boxes=graphs, share=share
    )
    free = _free_bytes(device)
    description = f"{len(position):,} particles, {edges:,} edges, about {needed / 1e9:.2g} GB a step"
    if needed > free:
        raise InputError(
            f"{description}, but {free / 1e9:.3g} GB are free on {device}; take fewer scenes at once, a coarser "
            "simulator, or more devices."
        )
    return f"{description} of {free / 1e9:.3g} GB free"


def _free_bytes(device: torch.device) -> int:
    return int(torch.cuda.mem_get_info(device)[0]) if device.type == "cuda" else free_memory()
