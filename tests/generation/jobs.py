"""Jobs for the pool, in a module that spawned processes can import."""

from __future__ import annotations

import os
import signal

from gns_pl.errors import InputError
from gns_pl.io import StorageError


def work(job: int | str) -> int:
    if job == "input":
        raise InputError("cannot be used.")
    if job == "storage":
        raise StorageError("the disk is full.")
    if job == "bug":
        raise ZeroDivisionError("by zero")
    if job == "memory":
        raise MemoryError
    if job == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "exit":
        os._exit(3)
    if job == "threads":
        return int(os.environ["OMP_NUM_THREADS"])
    return 2 * int(job)
