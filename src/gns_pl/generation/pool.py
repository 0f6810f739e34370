"""Many jobs at once in processes of their own: one that fails, or dies, takes no other with it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Generic, TypeVar

from gns_pl.errors import InputError
from gns_pl.io import StorageError

J = TypeVar("J")
R = TypeVar("R")

_ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Failure:
    """Why a job has no result.

    Attributes:
        message: for the user.
        details: traceback, for whoever mends it; "" where the message says all.
        final: nothing else can succeed either; a full disk.
    """

    message: str
    details: str = ""
    final: bool = False


@dataclass
class _Worker(Generic[J]):
    process: BaseProcess
    connection: Connection
    index: int | None = None


def run_jobs(
    function: Callable[[J], R], jobs: Sequence[J], num_workers: int
) -> Generator[tuple[int, R | Failure], None, None]:
    """Run `function` on every job and yield (index of the job, result or `Failure`) as they finish.

    With one worker everything happens in this process. More are spawned, each with one thread; they end with this
    process, however it ends. Closing the generator ends them at once.

    Args:
        function: a module-level function.
        jobs: its arguments; they must pickle.
        num_workers: number of processes.
    """
    if num_workers <= 1:
        for index, job in enumerate(jobs):
            yield index, attempt(function, job)
        return
    waiting = deque(range(len(jobs)))
    workers: list[_Worker[J]] = []
    try:
        while waiting or any(worker.index is not None for worker in workers):
            while waiting and len(workers) < num_workers:
                workers.append(_start(function))
            for worker in workers:
                if worker.index is None and waiting:
                    worker.index = waiting.popleft()
                    with contextlib.suppress(OSError):  # a dead worker is noticed below
                        worker.connection.send(jobs[worker.index])
            ready = wait([worker.connection for worker in workers])
            for worker in [worker for worker in workers if worker.connection in ready]:
                finished, worker.index = worker.index, None
                try:
                    outcome: R | Failure = worker.connection.recv()
                except (EOFError, OSError):
                    workers.remove(worker)
                    worker.process.join()
                    outcome = Failure(f"its process died ({_cause(worker.process.exitcode)})")
                if finished is not None:
                    yield finished, outcome
    finally:
        for worker in workers:
            worker.process.kill()
        for worker in workers:
            worker.process.join()
            worker.connection.close()


def _start(function: Callable[[J], R]) -> _Worker[J]:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, function), daemon=True)
    with _one_thread():
        process.start()
    there.close()
    return _Worker(process, here)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Tell child processes started inside to use one thread each; NumPy and numba read this when they are imported."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(connection: Connection, function: Callable[[J], R]) -> None:
    """Work through what comes until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which ends this process
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(attempt(function, connection.recv()))


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def attempt(function: Callable[[J], R], job: J) -> R | Failure:
    """Return what `function` makes of `job`, or why it makes nothing of it."""
    try:
        return function(job)
    except InputError as error:
        return Failure(str(error), final=isinstance(error, StorageError))
    except MemoryError:
        return Failure("out of memory")
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}", traceback.format_exc())


def _cause(exitcode: int | None) -> str:
    if exitcode == -signal.SIGKILL:
        return "killed, perhaps for want of memory"
    return f"exit status {exitcode}"
