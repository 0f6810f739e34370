"""What makes a step faster without touching the network: each a wrapper that can be had alone.

Positions, their differences and the integration stay in float32 whatever the network computes in.
"""

from __future__ import annotations

import copy
import math
from typing import cast

import torch
from torch import Tensor, nn

from gns_pl.errors import InputError
from gns_pl.graph import NeighbourList, SceneBatch, radius_graph
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.simulator import Evaluation, Simulator
from gns_pl.nn import EncodeProcessDecode, network_class
from gns_pl.nn.encode_process_decode import FUSED_WIDTHS
from gns_pl.rollout.stepper import SimulatorStepper, Stepper

PRECISIONS = ("float32", "tf32", "bfloat16")

EDGE_BUDGET = 8192
"""A compiled network sees numbers of edges that are multiples of this, so that it is compiled for few of them."""


HEADROOM = 1.2
"""A captured step has room for so many times the edges that there were when it was captured."""


def accelerate(
    simulator: Simulator,
    *,
    skin: float = 0.0,
    precision: str = "float32",
    compiled: bool = False,
    captured: bool = False,
) -> Stepper:
    """Return what makes a simulator's steps in another way, with the same weights.

    Args:
        simulator: stays as it is.
        skin: neighbours are searched again when a particle has moved half of so many connectivity radii; 0: each step.
        precision: of the network's products; for GPUs. "bfloat16" changes accelerations by up to 4 % of their root
            mean square, "tf32" by less.
        compiled: by `torch.compile`, on CUDA with its graphs; the first steps take up to minutes.
        captured: whole steps become a CUDA graph, neighbours included, which a GPU makes without waiting for the CPU.

    Raises:
        InputError: a negative skin, an unknown precision, or what does not go together.
    """
    if not skin >= 0:
        raise InputError(f"acceleration.skin must be 0 or more connectivity radii, not {skin}.")
    if precision not in PRECISIONS:
        raise InputError(f"acceleration.precision must be one of {', '.join(PRECISIONS)}, not {precision!r}.")
    if captured and (skin or compiled):
        raise InputError("acceleration.captured stands alone: with skin=0 and compiled=false.")
    if captured and simulator.config.self_loops:
        raise InputError("acceleration.captured knows no edges from a particle to itself, which this simulator has.")
    if captured and not can_capture(simulator):
        raise InputError(
            f"acceleration.captured needs a GPU with Triton, a latent_size of {', '.join(map(str, FUSED_WIDTHS))}."
        )
    network = cast(nn.Module, simulator.network)
    if captured:
        network = copy.copy(network)  # its kernels' weights, which the graph points at, are then nobody else's
    if compiled:
        network = Padded(_compile(network), EDGE_BUDGET)
    if precision != "float32":
        network = InPrecision(network, precision)
    if captured:
        return CapturedStepper(simulator, network)
    return SimulatorStepper(simulator, NeighbourList(skin) if skin else radius_graph, network)


def can_capture(simulator: Simulator) -> bool:
    """Return whether steps of a simulator can become CUDA graphs."""
    fuses = network_class(simulator.config.network).fuses(simulator.config.latent_size)
    return simulator.device.type == "cuda" and fuses


class CapturedStepper:
    """Steps of a simulator as a CUDA graph: some hundred kernels for one start.

    The graph holds for a number of particles and for the scenes; of the edges it holds as many as there is room for. A
    step that has more is thrown away and made again with more room.

    Args:
        simulator: whose steps these are, on a GPU; without gradients.
        network: evaluated in the place of the simulator's own.

    Attributes:
        normalised: of the latest step, the network's (a − g) / `acceleration_scale` [N, D].
    """

    def __init__(self, simulator: Simulator, network: Evaluation) -> None:
        from gns_pl.graph.bounded import BoundedSearch

        self._search = BoundedSearch(0)
        self._stepper = SimulatorStepper(simulator, self._search, network)
        self.normalised = torch.empty(0)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._scenes: SceneBatch | None = None
        self._history = self._position = torch.empty(0)

    @property
    def config(self) -> SimulatorConfig:
        """Of the simulator."""
        return self._stepper.config

    @property
    def history_length(self) -> int:
        """H."""
        return self._stepper.history_length

    @property
    def device(self) -> torch.device:
        """Of the simulator's weights."""
        return self._stepper.device

    def __call__(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the positions one step later; arguments as those of the simulator."""
        if self._graph is None or self._scenes is not scenes or self._history.shape != history.shape:
            self._capture(history, scenes)
        while True:
            self._history.copy_(history)
            cast(torch.cuda.CUDAGraph, self._graph).replay()
            if int(self._search.wanted) <= self._search.capacity:
                return self._position.clone()
            self._capture(history, scenes)

    def _capture(self, history: Tensor, scenes: SceneBatch) -> None:
        self._graph = None  # its memory goes back first
        config = self.config
        self._search(history[:, -1], config.connectivity_radius, scenes.batch, num_graphs=scenes.num_graphs)
        self._search.capacity = EDGE_BUDGET * math.ceil(HEADROOM * int(self._search.wanted) / EDGE_BUDGET + 1)
        self._history, self._scenes = history.clone(), scenes
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(2):  # what is compiled or set up at a first call must not be captured
                self._step()
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._step()
        self._graph = graph

    def _step(self) -> None:
        scenes = cast(SceneBatch, self._scenes)
        self.normalised = self._stepper.normalised_acceleration(self._history, scenes)
        self._position = self._stepper.simulator.integrate(self._history, self.normalised, scenes)


def _compile(network: nn.Module) -> nn.Module:
    network = cast(EncodeProcessDecode, copy.copy(network))  # shares the weights
    network.compiled_edges = False  # torch.compile fuses on its own, and cannot look into ours
    mode = "reduce-overhead" if next(network.parameters()).device.type == "cuda" else "default"
    return cast(nn.Module, torch.compile(network, dynamic=False, mode=mode))


class Padded(nn.Module):
    """A network that gets one node and some edges more, so that shapes repeat; the edges join that node to itself.

    Args:
        network: as `EncodeProcessDecode`.
        budget: numbers of edges are rounded up to a multiple.
    """

    def __init__(self, network: nn.Module, budget: int) -> None:
        super().__init__()
        self.network, self.budget = network, budget

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return what the network gives for the nodes that there are; arguments as the network's."""
        missing = -len(edge) % self.budget
        node = torch.cat([node, node.new_zeros(1, node.shape[1])])
        edge = torch.cat([edge, edge.new_zeros(missing, edge.shape[1])])
        edge_index = torch.cat([edge_index, edge_index.new_full((2, missing), len(node) - 1)], dim=1)
        output: Tensor = self.network(node, edge, edge_index)
        return output[:-1].clone()  # a CUDA graph writes its next output over this one


class InPrecision(nn.Module):
    """A network whose products are made in less than float32; what goes in and comes out is float32.

    Args:
        network: as `EncodeProcessDecode`.
        precision: "tf32" or "bfloat16".
    """

    def __init__(self, network: nn.Module, precision: str) -> None:
        super().__init__()
        self.network, self.precision = network, precision

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return what the network gives; arguments as the network's."""
        if self.precision == "bfloat16":
            with torch.autocast(node.device.type, dtype=torch.bfloat16):
                return cast(Tensor, self.network(node, edge, edge_index)).float()
        before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision("high")
        try:
            return cast(Tensor, self.network(node, edge, edge_index))
        finally:
            torch.set_float32_matmul_precision(before)
