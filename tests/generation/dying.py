"""A program that generates a thinned set and is killed as soon as its NUMBER-th file is there.

Run as `python -m tests.generation.dying ROOT NUMBER`.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

from gns_pl.generation import generate_dataset, produce
from gns_pl.io import write_trajectory
from gns_pl.mpm import settings as solver
from gns_pl.trajectory import Trajectory
from tests.generation.fake import fake_solver, make_thinned_spec

written = 0


def _write_and_die(path: Path, trajectory: Trajectory) -> None:
    global written
    write_trajectory(path, trajectory)
    written += 1
    if written == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    solver.run_solver = fake_solver
    produce.write_trajectory = _write_and_die
    generate_dataset(make_thinned_spec(), root=Path(sys.argv[1]), num_workers=1, progress=False)
