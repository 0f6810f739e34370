"""Killed at any moment, a generation loses nothing that was finished and ends as if nothing had happened."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gns_pl.generation import generate_dataset
from gns_pl.io import verify_dataset
from tests.generation.fake import make_spec
from tests.generation.test_dataset import sums, times

REPOSITORY = Path(__file__).parents[2]


def start(root: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.generation.fake", str(root), *arguments],
        cwd=REPOSITORY,
        stderr=subprocess.PIPE,
        text=True,
        # What a shell starts in the background ignores Ctrl-C, and hands that down; the tests must not mind.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def wait_for(condition: Callable[[], bool], seconds: float = 30) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


def children(pid: int) -> list[int]:
    """Return the processes whose parent is `pid`."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def _has_more(root: Path, number: int) -> bool:
    return len(times(root)) > number


def _are_gone(pids: list[int]) -> bool:
    return all(_state(pid) in {"", "Z"} for pid in pids)  # a zombie waits for nothing but its burial


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("workers", ["1", "2"])
def test_killed_again_and_again(faked: None, tmp_path: Path, workers: str) -> None:
    whole = generate_dataset(make_spec(), root=tmp_path / "whole", num_workers=1, progress=False)
    root = tmp_path / "killed"
    finished: dict[str, int] = {}
    for delay in np.random.default_rng(int(workers)).uniform(0, 0.15, 3):
        process = start(root, workers, "0.15")
        wait_for(partial(_has_more, root, len(finished)))
        time.sleep(delay)
        family = children(process.pid)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL, "it ended by itself"
        wait_for(partial(_are_gone, family))  # workers go with it
        now = times(root)
        assert now.items() >= finished.items()
        assert len(now) > len(finished)
        finished = now
        assert not (root / "manifest.json").exists()
    (root / ".trajectory_0007.h5.1-abcd.part").write_bytes(b"half")
    generate_dataset(make_spec(), root=root, num_workers=1, progress=False)
    assert times(root).items() >= finished.items()
    assert sums(root) == sums(whole)
    verify_dataset(root)
    assert not list(root.glob(".*.part"))


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_file_that_cannot_grow_is_one_sentence_and_leaves_nothing_half(tmp_path: Path, workers: str) -> None:
    root = tmp_path / "set"
    process = start(root, workers, "0", "9000")
    told = process.communicate(timeout=60)[1]
    assert process.returncode == 2
    last = told.splitlines()[-1]
    assert last.startswith(f"fake.py: {root}/trajectory_")
    assert last.endswith("cannot be written (File too large).")
    assert "Traceback" not in told
    assert not list(root.glob(".*.part"))
    assert not (root / "manifest.json").exists()
    generate_dataset(make_spec(), root=root, num_workers=1, progress=False)
    verify_dataset(root)


def test_an_interrupted_generation_ends_its_processes(tmp_path: Path) -> None:
    process = start(tmp_path / "set", "2", "1")
    wait_for(partial(_has_more, tmp_path / "set", 0))
    family = children(process.pid)
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=10)
    assert process.returncode not in (0, None)
    wait_for(partial(_are_gone, family))
