"""Runs of Weights & Biases: started, closed whatever happens, and left out where they are switched off.

What is logged is the caller's; nothing here knows a scene or a model.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, ParamSpec

from gns_pl.errors import InputError
from gns_pl.machine import provide_home
from gns_pl.text import shown_path

P = ParamSpec("P")
Mode = Literal["disabled", "offline", "online"]
MODES: dict[str, Mode] = {"disabled": "disabled", "offline": "offline", "dryrun": "offline"}
"""Values of WANDB_MODE that ask for less than `logger.offline` does; the others leave it to that."""


def wandb_mode(offline: bool) -> Mode:
    """Return W&B's mode: "disabled", "offline" or "online".

    Args:
        offline: what the settings say. WANDB_MODE may switch W&B off or keep it on this disk, but nothing is sent
            because of it.

    Raises:
        InputError: WANDB_MODE is none of W&B's modes.
    """
    value = os.environ.get("WANDB_MODE", "").strip().lower()
    if value not in (*MODES, "", "online", "run", "shared"):
        raise InputError(f"WANDB_MODE={value}: W&B knows online, offline and disabled.")
    return MODES.get(value, "offline" if offline else "online")


def unless_disabled(log: Callable[P, Path]) -> Callable[P, list[Path]]:
    """Return a function that logs and gives the run's folder in a list.

    The folder is told relative to the working directory where it lies below it. The list is empty where W&B is switched
    off, and where its own files cannot be written: results are on disk by then, and no log is worth losing the command
    that made them.
    """

    @functools.wraps(log)
    def log_or_not(*args: P.args, **kwargs: P.kwargs) -> list[Path]:
        if wandb_mode(True) == "disabled":
            return []
        try:
            return [Path(shown_path(log(*args, **kwargs)))]
        except OSError as error:
            print(f"W&B could not write its files ({error}); the results are on disk without.", file=sys.stderr)
            return []

    return log_or_not


@contextmanager
def started(
    job_type: str, config: Mapping[str, Any], *, out: Path, offline: bool, project: str, **more: Any
) -> Iterator[Any]:
    """Give a W&B run, and close it whatever happens.

    Args:
        job_type: of the run.
        config: of the run.
        out: folder under which W&B puts its own folder.
        offline: keep the run on this disk.
        project: W&B project.
        **more: of `wandb.init`.

    Raises:
        InputError: W&B refuses to start, as it does online without an account. The results are on disk by then.
    """
    mode = wandb_mode(offline)
    provide_home()
    import wandb

    try:
        run = wandb.init(
            project=project,
            job_type=job_type,
            dir=str(out.absolute()),  # W&B's own process stays where the first run of this one was started
            mode=mode,
            config=dict(config),
            settings=wandb.Settings(silent=True, console="off"),
            **more,
        )
    except wandb.errors.Error as error:
        raise InputError(
            f"W&B could not start ({error}); the results are in {out}, and logger.offline=true needs no account."
        ) from error
    try:
        yield run
    finally:
        wandb.finish()
