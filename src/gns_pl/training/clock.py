"""How long a training takes: its wall time over all starts, and the time of a step; and what it cost in all."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, cast

import torch
from lightning.pytorch import Callback, LightningModule, Trainer

from gns_pl.generation.records import read_timings
from gns_pl.machine import machine_name


class Stopwatch(Callback):
    """Measures the wall time of a fit over all its starts.

    The time goes into checkpoints, so that a resumed run's goes on where its checkpoint was written. What a killed
    start did after its last checkpoint is lost, and its time is not counted either.
    """

    def __init__(self) -> None:
        self._before = 0.0
        self._began: float | None = None

    @property
    def seconds(self) -> float:
        """Wall time of the fit so far, with that of the starts before [s]."""
        return self._before + (0.0 if self._began is None else time.perf_counter() - self._began)

    def state_dict(self) -> dict[str, Any]:
        """Return the time so far."""
        return {"seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the time of a checkpoint."""
        self._before = float(state_dict["seconds"])

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Start."""
        self._began = time.perf_counter()


class Clock(Stopwatch):
    """Logs `hours` beside the loss and every validation, and `step_seconds`, the mean since, with `windows_per_s`.

    `step_seconds` leaves validations out; a median over them leaves the writing of checkpoints out, too.
    """

    def __init__(self) -> None:
        super().__init__()
        self._mark = (0.0, 0)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Start."""
        super().on_train_start(trainer, pl_module)
        self._mark = (time.perf_counter(), trainer.global_step)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Log as often as the loss is logged."""
        since, before = self._mark
        step = trainer.global_step
        if step % cast(Any, trainer).log_every_n_steps == 0 and step > before:
            float(outputs["loss"])  # waits for the device
            now = time.perf_counter()
            seconds = (now - since) / (step - before)
            windows = cast(Any, trainer).datamodule.batch_size  # of all processes
            pl_module.log("step_seconds", seconds, batch_size=1)
            pl_module.log("windows_per_s", windows / seconds, prog_bar=True, batch_size=1)
            pl_module.log("hours", self.seconds / 3600, batch_size=1)
            self._mark = (now, step)

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log when the errors were reached."""
        pl_module.log("hours", self.seconds / 3600, batch_size=1, sync_dist=True)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Leave the validation out of the time of a step."""
        self._mark = (time.perf_counter(), trainer.global_step)


def cost_of(directory: Path, train_seconds: float | None = None) -> dict[str, Any]:
    """Return what a training costs, as checkpoints keep it in their provenance.

    Args:
        directory: of the data.
        train_seconds: wall time of the fit [s]; None if it is not known, or not yet.

    Returns:
        data_seconds, the solver's time for all trajectories, one after the other [s], None if the folder does not say;
        train_seconds; machine and num_threads of the training.
    """
    return {
        "data_seconds": read_timings(directory),
        "train_seconds": train_seconds,
        "machine": machine_name(),
        "num_threads": torch.get_num_threads(),
    }
