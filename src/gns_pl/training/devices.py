"""Several processes that train together: how many there may be, and that they begin and end together.

Lightning's DDP starts `train.py` once more for every further device. The first process, rank zero, does all that is
done once: it generates data, prints, logs and writes.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.fabric.utilities.rank_zero import rank_zero_only
from lightning.pytorch import Trainer

from gns_pl.errors import InputError


def is_rank_zero() -> bool:
    """Whether this process is the one that prints and writes; known before there is a trainer."""
    return int(getattr(rank_zero_only, "rank", None) or 0) == 0


def check_devices(trainer: Trainer, batch_size: int) -> None:
    """Make sure that the windows of a step can be shared by the processes.

    Args:
        trainer: not started.
        batch_size: windows per step.

    Raises:
        InputError: they cannot, or a sweep is to run on several devices.
    """
    processes = trainer.num_nodes * trainer.num_devices
    if batch_size % processes:
        raise InputError(
            f"training.batch_size={batch_size} windows per step cannot be shared by {processes} processes alike; "
            "make it a multiple, or set trainer.devices."
        )
    if processes > 1 and HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN:
        raise InputError("a sweep trains every job on one device; set trainer.devices=1.")


@contextmanager
def end_together(trainer: Trainer) -> Iterator[None]:
    """Let no process of a run wait for one that has ended, and only the first one speak.

    Raises:
        SystemExit: with status 0, in the other processes, for whatever the first one tells the user.
    """
    if not is_rank_zero():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the first one decides
        threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    try:
        yield
    except BaseException as error:
        # Otherwise they would wait for this process, and Lightning's observer would kill it because they have ended.
        started: list[Any] = getattr(trainer.strategy.launcher, "procs", [])
        children = started.copy()
        started.clear()
        for child in children:
            child.kill()
            child.wait()
        if isinstance(error, InputError | SystemExit) and not is_rank_zero():
            raise SystemExit(0) from None
        raise


def _end_with_parent(parent: int) -> None:
    """End this process once its parent, the first process, was killed; on a GPU it would wait for it for minutes."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)
