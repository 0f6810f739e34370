from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import gns_pl.rollout.memory
from gns_pl.errors import InputError
from gns_pl.rollout import Run
from gns_pl.rollout.memory import check_memory
from gns_pl.scene import Scene
from tests.conftest import make_simulator, make_start

MEASURE = """
import math, resource, sys, torch
from tests.conftest import SAND, make_simulator, make_start
from gns_pl.graph import radius_graph
from gns_pl.rollout.engine import Run, history_of
from gns_pl.rollout.static import static_of
from gns_pl.rollout.memory import estimate_bytes
from gns_pl.scene import FACES, Wall, column_collapse
walls = dict.fromkeys(FACES[3], Wall("slip"))
edge, length, width = map(float, sys.argv[1:])
simulator = make_simulator(output="gated", context=True, latent_size=int(width), num_message_passing_steps=3)

def prepare(length):
    scene = column_collapse(domain=(edge, 2, edge), length=length, height=length, gravity=9.81, duration=1,
                            material=SAND, walls=walls)
    run = Run(make_start(scene), 1)
    return history_of(run, simulator.config), static_of(run.start)

with torch.inference_mode():
    small, large = prepare(0.3), prepare(length)
    simulator(*small)
    config = simulator.config
    edges = radius_graph(large[0][:, -1], config.connectivity_radius).shape[1]
    nodes = math.prod(large[1].grid(config.connectivity_radius).shape)
    estimate = estimate_bytes(config, len(large[0]), edges, in_blocks=True, nodes=nodes)
    used = next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith("VmData"))
    for share in (0.7, 1.3):
        large[1]._grids.clear()
        resource.setrlimit(resource.RLIMIT_DATA, (used + int(share * estimate), resource.RLIM_INFINITY))
        try:
            simulator(*large)
            print(share, "fits")
        except (MemoryError, RuntimeError) as error:
            print(share, "does not fit")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits what /proc tells")
@pytest.mark.parametrize(
    ("edge", "length", "width"),
    [(3, 1.7, 48), (22, 0.9, 4), (100, 1.7, 4)],
    ids=["network", "whole grid", "grid at particles"],
)
def test_the_estimate_is_about_what_a_step_takes(edge: float, length: float, width: int) -> None:
    """A step fits into a third more than its estimate, and not into a third less, whatever takes most of it.

    Freed blocks go back to the system at once, so that what counts is what is held, not what the C library keeps.
    """
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", MEASURE, *map(str, (edge, length, width))]
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": str(2**18), "MALLOC_ARENA_MAX": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines() == ["0.7 does not fit", "1.3 fits"]


def test_what_does_not_fit_is_refused_with_the_numbers(drop: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, runs = make_simulator(), [Run(make_start(drop), 3)]
    assert "216 particles" in check_memory(simulator, runs)
    monkeypatch.setattr(gns_pl.rollout.memory, "_free_bytes", lambda device: 1000)
    with pytest.raises(
        InputError, match=r"216 particles, [\d,]+ edges, about .* GB a step, but 1e-06 GB are free on cpu"
    ):
        check_memory(simulator, runs)
