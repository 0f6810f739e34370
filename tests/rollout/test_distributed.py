"""A rollout on several processes is the one of a single process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.distributed as dist

from gns_pl.graph import radius_graph
from gns_pl.rollout import rollout
from gns_pl.rollout.distributed import cut_slabs, distribute
from gns_pl.scene import FACES, Wall, column_collapse
from gns_pl.trajectory import Trajectory
from tests.conftest import SAND, make_simulator, make_start, start_processes

RADIUS = 0.11


def wide_column() -> Trajectory:
    walls = {face: Wall("friction", 0.385) for face in FACES[3]}
    scene = column_collapse(
        domain=(2.0, 0.3, 0.5), length=0.8, height=0.3, gravity=9.81, duration=0.2, material=SAND, walls=walls
    )
    return make_start(scene)


@pytest.mark.parametrize("size", [1, 2, 3, 7])
def test_slabs_hold_every_particle_once_and_every_neighbour(size: int) -> None:
    position = torch.rand(400, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 0.3, 0.3])
    slabs = [cut_slabs(position, RADIUS, rank, size) for rank in range(size)]
    assert torch.equal(torch.cat([slab.own for slab in slabs]).sort().values, torch.arange(400))
    assert max(len(slab.own) for slab in slabs) - min(len(slab.own) for slab in slabs) <= 1
    sender, receiver = radius_graph(position, RADIUS)
    for rank, slab in enumerate(slabs):
        needed = sender[torch.isin(receiver, slab.own)]
        assert torch.isin(needed, torch.cat([slab.own, slab.halo])).all()
        for other, there in enumerate(slabs):
            assert torch.equal(slab.own[slab.send[other]], there.halo[there.receive[rank]])


def step_together(rank: int, size: int, meeting: str, settings: dict[str, Any], compiled: bool, out: str) -> None:
    torch.set_num_threads(1)
    dist.init_process_group("gloo", init_method=f"file://{meeting}", rank=rank, world_size=size)
    simulator = make_simulator(output="gated", **settings)
    simulator.network.compiled_edges = compiled
    frames = rollout(distribute(simulator), wide_column(), 6).position
    np.save(f"{out}-{rank}.npy", frames)
    dist.destroy_process_group()


@pytest.mark.parametrize(("settings", "compiled"), [({"context": True}, True), ({"context": False}, False)])
def test_two_processes_make_the_rollout_of_one(settings: dict[str, Any], compiled: bool, tmp_path: Path) -> None:
    arguments = (2, str(tmp_path / "meeting"), settings, compiled, str(tmp_path / "frames"))
    start_processes(step_together, arguments, 2)
    start = wide_column()
    alone = rollout(make_simulator(output="gated", **settings), start, 6).position
    first, second = (np.load(tmp_path / f"frames-{rank}.npy") for rank in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(first, alone, atol=2e-6)
    assert np.abs(alone[-1] - alone[0]).max() > 0.003
