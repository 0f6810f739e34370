"""One job that fails, or whose process dies, takes no other with it."""

from __future__ import annotations

import multiprocessing
import os

import pytest

from gns_pl.generation.pool import Failure, run_jobs
from gns_pl.machine import available_cores
from tests.generation.jobs import work


def test_in_this_process() -> None:
    outcomes = list(run_jobs(work, [1, "input", "bug", "storage", "memory", 5], 1))
    assert [index for index, _ in outcomes] == list(range(6))
    results = [outcome for _, outcome in outcomes]
    assert results[0] == 2
    assert results[1] == Failure("cannot be used.")
    assert isinstance(results[2], Failure)
    assert results[2].message == "ZeroDivisionError: by zero"
    assert "Traceback" in results[2].details
    assert results[3] == Failure("the disk is full.", final=True)
    assert results[4] == Failure("out of memory")
    assert results[5] == 10


def test_in_processes_that_die() -> None:
    before = dict(os.environ)
    jobs = [1, "killed", 2, "exit", "bug", 3, "threads", 4]
    outcomes = dict(run_jobs(work, jobs, 2))
    assert sorted(outcomes) == list(range(8))
    assert [outcomes[index] for index in (0, 2, 5, 7)] == [2, 4, 6, 8]
    assert outcomes[1] == Failure("its process died (killed, perhaps for want of memory)")
    assert outcomes[3] == Failure("its process died (exit status 3)")
    assert outcomes[6] == 1
    assert dict(os.environ) == before
    assert not multiprocessing.active_children()


def test_closing_ends_the_processes() -> None:
    outcomes = run_jobs(work, list(range(50)), 2)
    next(outcomes)
    assert multiprocessing.active_children()
    outcomes.close()
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("workers", [1, 2])
def test_nothing_to_do(workers: int) -> None:
    assert list(run_jobs(work, [], workers)) == []


def test_there_is_a_core() -> None:
    assert available_cores() >= 1
