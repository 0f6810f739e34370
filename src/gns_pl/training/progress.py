"""What a user sees while a training runs: a bar on a terminal, and a line after every validation everywhere."""

from __future__ import annotations

import math
import time
from datetime import timedelta
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import RichProgressBar

from gns_pl.training.summary import described

SECONDS_BETWEEN_READINGS = 1.0
"""The loss is read this often at most: every reading waits for the device."""


def validation_values(trainer: Trainer) -> dict[str, float]:
    """Return the errors of the latest validation by name, without their prefix; empty before the first one."""
    return {
        name.removeprefix("valid/"): float(value)
        for name, value in trainer.callback_metrics.items()
        if name.startswith("valid/")
    }


class ValidationLine(Callback):
    """Prints a line after every validation, so that a log file without a bar tells how far the training is."""

    def __init__(self) -> None:
        self._latest = (time.perf_counter(), 0)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Remember where this start begins."""
        self._latest = (time.perf_counter(), trainer.global_step)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Print steps, time left at the rate of the latest steps, for those of whole runs are slower, and errors."""
        if trainer.sanity_checking or not trainer.is_global_zero:
            return
        (before, first), now = self._latest, time.perf_counter()
        step, last = trainer.global_step, trainer.max_steps
        self._latest = now, step
        left = (now - before) / max(1, step - first) * (last - step)
        to_go = f", {timedelta(seconds=round(left))} to go" if step < last else ""
        print(f"step {step:,} of {last:,}{to_go}: {described(validation_values(trainer))}", flush=True)


class TrainingProgress(RichProgressBar):
    """A bar with the time taken and left, windows/s, the loss and two errors of the latest validation.

    These are the position error [spacings] and that of the final 99 % runout. Unlike Lightning's bar it reads the loss
    once a second and not in every step, for which the device would have to stop.

    Args:
        title: stands before the bar.
    """

    def __init__(self, title: str) -> None:
        super().__init__(refresh_rate=4)
        self._title = title
        self._read = -math.inf
        self._shown: dict[str, Any] = {}

    def configure_columns(self, trainer: Trainer) -> list[Any]:
        """Return description, bar, counts and times; the metrics follow."""
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        return [
            TextColumn("{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        ]

    def _get_train_description(self, current_epoch: int) -> str:
        return self._title  # an epoch is the whole training, and its number says nothing

    def get_metrics(self, trainer: Trainer, pl_module: LightningModule) -> dict[str, Any]:
        """Return what stands behind the bar: label → text."""
        if time.perf_counter() - self._read >= SECONDS_BETWEEN_READINGS:
            logged = trainer.progress_bar_metrics
            self._shown = {}
            if "windows_per_s" in logged:
                self._shown["windows/s"] = f"{float(logged['windows_per_s']):.0f}"
            if "loss" in logged:
                self._shown["loss"] = f"{float(logged['loss']):.3g}"
            errors = validation_values(trainer)
            if "position_error" in errors:
                self._shown["error"] = f"{errors['position_error']:.3g}"
            if "runout_99_error" in errors:
                self._shown["runout"] = f"{100 * errors['runout_99_error']:+.0f}%"
            self._read = time.perf_counter()
        return self._shown
