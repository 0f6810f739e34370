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
import resource, torch
from tests.conftest import SAND, make_simulator, make_start
from gns_pl.rollout.engine import Run, history_of, static_of
from gns_pl.rollout.memory import estimate_bytes
from gns_pl.scene import FACES, Wall, column_collapse
walls = dict.fromkeys(FACES[3], Wall("slip"))
simulator = make_simulator(output="gated", context=True, latent_size=48, num_message_passing_steps=3)

def measure(length):
    scene = column_collapse(domain=(3, 2, 3), length=length, height=length, gravity=9.81, duration=1, material=SAND,
                            walls=walls)
    run = Run(make_start(scene), 1)
    history, static, config = history_of(run, simulator.config), static_of(run.start), simulator.config
    before = int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()
    with torch.inference_mode():
        simulator(history, static)
        edges = simulator.search(history[:, -1], config.connectivity_radius).shape[1]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return peak - before, estimate_bytes(config, run.start.num_particles, edges, in_blocks=True)

measure(0.3)
print(*measure(1.7))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="measured in /proc")
def test_the_estimate_is_about_what_a_step_takes() -> None:
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", MEASURE]
    # Freed blocks go back to the system at once, so that the peak is what is held, not what the C library keeps. What
    # else a process does, as compiling, only adds to it: the least of two is nearer.
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": str(2**18), "MALLOC_ARENA_MAX": "1"}
    said = [
        subprocess.run(command, cwd=root, capture_output=True, text=True, check=True, env=environment).stdout
        for _ in range(2)
    ]
    measured, estimated = min(tuple(map(int, each.split())) for each in said)
    assert measured > 1e8
    assert 0.8 < estimated / measured < 1.5


def test_what_does_not_fit_is_refused_with_the_numbers(drop: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, runs = make_simulator(), [Run(make_start(drop), 3)]
    assert "216 particles" in check_memory(simulator, runs)
    monkeypatch.setattr(gns_pl.rollout.memory, "_free_bytes", lambda device: 1000)
    with pytest.raises(
        InputError, match=r"216 particles, [\d,]+ edges, about .* GB a step, but 1e-06 GB are free on cpu"
    ):
        check_memory(simulator, runs)
