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
import resource, sys, torch
from tests.conftest import SAND, make_simulator, make_start
from gns_pl.rollout.engine import Run, history_of, static_of
from gns_pl.rollout.memory import estimate_bytes
from gns_pl.scene import FACES, Wall, column_collapse
walls = dict.fromkeys(FACES[3], Wall("slip"))
simulator = make_simulator(output="gated", context=True, latent_size=48, num_message_passing_steps=3)

def prepare(length):
    scene = column_collapse(domain=(3, 2, 3), length=length, height=length, gravity=9.81, duration=1, material=SAND,
                            walls=walls)
    run = Run(make_start(scene), 1)
    return history_of(run, simulator.config), static_of(run.start)

with torch.inference_mode():
    small, large = prepare(0.3), prepare(1.7)
    simulator(*small)
    config = simulator.config
    edges = simulator.search(large[0][:, -1], config.connectivity_radius).shape[1]
    estimate = estimate_bytes(config, len(large[0]), edges, in_blocks=True)
    used = next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith("VmData"))
    limit = used + int(float(sys.argv[1]) * estimate)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    try:
        simulator(*large)
        print("fits")
    except (MemoryError, RuntimeError) as error:
        print("does not fit:", error)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits what /proc tells")
@pytest.mark.parametrize(("share", "said"), [(1.3, "fits"), (0.7, "does not fit")])
def test_the_estimate_is_about_what_a_step_takes(share: float, said: str) -> None:
    """A step fits into a third more than its estimate, and not into a third less.

    Freed blocks go back to the system at once, so that what counts is what is held, not what the C library keeps.
    """
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", MEASURE, str(share)]
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": str(2**18), "MALLOC_ARENA_MAX": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.startswith(said), done.stdout


def test_what_does_not_fit_is_refused_with_the_numbers(drop: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, runs = make_simulator(), [Run(make_start(drop), 3)]
    assert "216 particles" in check_memory(simulator, runs)
    monkeypatch.setattr(gns_pl.rollout.memory, "_free_bytes", lambda device: 1000)
    with pytest.raises(
        InputError, match=r"216 particles, [\d,]+ edges, about .* GB a step, but 1e-06 GB are free on cpu"
    ):
        check_memory(simulator, runs)
