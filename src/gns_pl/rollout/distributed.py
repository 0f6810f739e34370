"""One rollout on several processes: each owns the particles of a slab, and what these receive.

What takes the time and the memory is shared out: edges, messages, states. Positions and node features are small, and
every process has all of them, so that overburdens and walls need no further thought. A process passes messages to the
particles it owns; the states of those within a connectivity radius of its slab, its halo, come from their owners after
every layer. Slabs lie across the longest horizontal axis and hold equal numbers of particles in every step.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch
import torch.distributed as dist
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, radius_graph
from gns_pl.nn import Network
from gns_pl.rollout.stepper import Stepper, opened


@dataclass(frozen=True)
class Slab:
    """What a process has to do in one step.

    Attributes:
        own: its particles, ascending [n].
        halo: particles of others that its own may receive from, ascending [m].
        send: for every process, which of its own (their places in `own`) lie in that one's halo.
        receive: for every process, which of the halo (their places in `halo`) are that one's own.
    """

    own: Tensor
    halo: Tensor
    send: tuple[Tensor, ...]
    receive: tuple[Tensor, ...]


def cut_slabs(position: Tensor, radius: float, rank: int, size: int) -> Slab:
    """Return the slab of process `rank` of `size`; all of them find the same cut from the same positions.

    Args:
        position: [N, D] [m].
        radius: connectivity radius R [m].
        rank: of the process.
        size: number of processes.
    """
    horizontal = position[:, :-1]
    along = horizontal[:, int((horizontal.amax(dim=0) - horizontal.amin(dim=0)).argmax())]
    owner = torch.empty(len(along), dtype=torch.int64, device=along.device)
    owner[along.argsort(stable=True)] = torch.arange(len(along), device=along.device) * size // max(1, len(along))
    reach = radius * (1 + 1e-5)  # rounding never loses a neighbour
    near = torch.zeros(size, len(along), dtype=torch.bool, device=along.device)
    for other in range(size):
        inside = along[owner == other]
        if len(inside):
            near[other] = (owner != other) & (along >= inside.min() - reach) & (along <= inside.max() + reach)
    own, halo = torch.nonzero(owner == rank)[:, 0], torch.nonzero(near[rank])[:, 0]
    send = tuple(torch.nonzero(near[other][own])[:, 0] for other in range(size))
    receive = tuple(torch.nonzero(owner[halo] == other)[:, 0] for other in range(size))
    return Slab(own, halo, send, receive)


def distribute(stepper: Stepper, group: dist.ProcessGroup | None = None) -> Stepper:
    """Return what makes the same steps together with the other processes of a group, each of which calls this.

    Args:
        stepper: stays as it is; alone in the group it comes back.
        group: of processes; all there are if None.

    Raises:
        InputError: a step that cannot be shared out.
    """
    size = dist.get_world_size(group) if dist.is_initialized() else 1
    return stepper if size == 1 else SlabStepper(stepper, group)


class SlabStepper:
    """Makes steps together with the other processes of a group; all of them end with all positions.

    Args:
        stepper: stays as it is.
        group: of processes; all there are if None.

    Raises:
        InputError: a step that cannot be shared out.
    """

    def __init__(self, stepper: Stepper, group: dist.ProcessGroup | None = None) -> None:
        self.group, self.rank, self.size = group, dist.get_rank(group), dist.get_world_size(group)
        self.slab: Slab | None = None
        self.config, self.device, self.history_length = stepper.config, stepper.device, stepper.history_length
        if stepper.config.self_loops:
            raise InputError("several processes share no run with edges from a particle to itself, as this one has.")
        single = opened(stepper)
        if single is None or not (isinstance(single.network, Network) and single.network.sliceable):
            raise InputError(
                "several processes share a run step by step: leave out acceleration.precision, compiled and captured."
            )
        self._network = copy.copy(single.network)
        self._network.exchange = self._exchange
        self._stepper = replace(single, search=self._search, network=self._evaluate)

    def __call__(self, history: Tensor, scenes: SceneBatch) -> Tensor:
        """Return the positions one step later [N, D] [m]; arguments as the simulator's."""
        position = self._stepper(history, scenes)
        others = torch.ones(len(position), dtype=torch.bool, device=position.device)
        others[self._current.own] = False
        position[others] = 0.0
        dist.all_reduce(position, group=self.group)
        return position

    @property
    def _current(self) -> Slab:
        assert self.slab is not None
        return self.slab

    def _search(
        self, position: Tensor, radius: float, batch: Tensor, *, backend: str = "auto", num_graphs: int = 1
    ) -> Tensor:
        """Return the edges to the particles this process owns, numbered as all particles are."""
        self.slab = cut_slabs(position, radius, self.rank, self.size)
        local = torch.cat([self.slab.own, self.slab.halo]).sort().values
        edges = radius_graph(position[local], radius, batch[local], backend=backend, num_graphs=num_graphs)
        owned = torch.zeros(len(position), dtype=torch.bool, device=position.device)
        owned[self.slab.own] = True
        edges = local[edges]
        return edges[:, owned[edges[1]]]

    def _evaluate(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Evaluate the network on the slab and its halo, with features and output of all particles."""
        slab = self._current
        local = torch.cat([slab.own, slab.halo])
        number = torch.empty(len(node), dtype=torch.int64, device=node.device)
        number[local] = torch.arange(len(local), device=node.device)
        output = self._network(node[local], edge, number[edge_index])
        everywhere: Tensor = output.new_zeros(len(node), output.shape[1])
        everywhere[slab.own] = output[: len(slab.own)]
        return everywhere

    def _exchange(self, node: Tensor) -> None:
        """Send what others need of the states of this process's particles, and fill in its halo."""
        slab = self._current
        length = len(slab.own)
        halo = node[length:]
        incoming = [node.new_empty(len(places), node.shape[1]) for places in slab.receive]
        work: list[dist.P2POp] = []
        for other, (send, into) in enumerate(zip(slab.send, incoming, strict=True)):
            peer = dist.get_global_rank(self.group, other) if self.group is not None else other
            if len(send):
                work.append(dist.P2POp(dist.isend, node[send], peer, self.group))
            if len(into):
                work.append(dist.P2POp(dist.irecv, into, peer, self.group))
        for request in dist.batch_isend_irecv(work) if work else []:
            request.wait()
        for places, states in zip(slab.receive, incoming, strict=True):
            halo[places] = states


@contextmanager
def processes(device: torch.device) -> Iterator[tuple[int, int]]:
    """Join the processes that `torchrun` has started, if it has; yields this one's number and how many there are.

    Args:
        device: where the tensors will be; on CUDA each process of a machine takes a device of its own.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield 0, 1
        return
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield dist.get_rank(), dist.get_world_size()
    finally:
        dist.destroy_process_group()


def barrier() -> None:
    """Wait until all processes are here; alone, go on."""
    if dist.is_initialized():
        dist.barrier()


def share_of_memory(device: torch.device) -> float:
    """Return the share of a run that one memory holds: a GPU its process's, a machine those of all its processes."""
    if not dist.is_initialized():
        return 1.0
    here = 1 if device.type == "cuda" else int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    return here / dist.get_world_size()
