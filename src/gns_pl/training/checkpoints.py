"""Which checkpoints a run keeps, and how they get onto the disk: whole or not at all."""

from __future__ import annotations

import io
import math
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint

from gns_pl.errors import InputError
from gns_pl.io.atomic import StorageError, atomic_path, write_atomically

LAST, BEST, NUMBERED = "last.ckpt", "best.ckpt", "step*.ckpt"


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes every checkpoint of a trainer whole or not at all, and leaves nothing else behind."""

    def save_checkpoint(
        self, checkpoint: Mapping[str, Any], path: str | os.PathLike[str], storage_options: Any | None = None
    ) -> None:
        """Write a checkpoint.

        Raises:
            StorageError: the disk refuses it, as a full one does; a checkpoint that was there before stays.
        """
        # torch's own writer turns a full disk into an error without errno, Lightning's leaves its temporary file.
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        write_atomically(Path(path), buffer.getbuffer())


class LastCheckpoint(Checkpoint):
    """Keeps `last.ckpt` of a run and the few before it: every so many steps, and however the fit ends.

    Lightning calls checkpoint callbacks after all others, so the average that is saved has taken the step in.
    If a validation follows, the checkpoint is written behind it: a resumed run does not miss a validation. Until then
    the steps are in the numbered checkpoint alone, which becomes `last.ckpt` if the validation ends in an error.

    Args:
        directory: folder of the run.
        every_n_steps: steps that a killed run loses at most.
        keep: how many of the numbered checkpoints (`step0001000.ckpt`) are kept; the last of them is `last.ckpt` too.

    Raises:
        InputError: a number below 1.
    """

    def __init__(self, directory: str, every_n_steps: int, keep: int) -> None:
        for name, value in (("every_n_steps", every_n_steps), ("keep", keep)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise InputError(f"callbacks.last.{name} must be a whole number of at least 1, not {value!r}.")
        self.directory = Path(directory)
        self.every_n_steps = every_n_steps
        self.keep = keep
        self._written = self._last = 0  # steps in the newest numbered checkpoint, and in last.ckpt
        self._between_steps = False  # nothing of a next step has changed weights or optimiser yet

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Note the steps that a resumed run begins with."""
        self._written = self._last = trainer.global_step
        self._between_steps = False

    def on_before_optimizer_step(self, trainer: Trainer, pl_module: LightningModule, optimizer: Any) -> None:
        """Note that a step changes the weights now."""
        self._between_steps = False

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save if it is time to, or if the run is being stopped."""
        step = trainer.global_step
        validated = validation_follows(trainer)
        if trainer.should_stop and not validated:
            trainer.limit_val_batches = 0  # or Lightning would validate where an uninterrupted run does not
        if trainer.should_stop or (not validated and (step % self.every_n_steps == 0 or step == trainer.max_steps)):
            self._write(trainer)
            self._keep(trainer)
        elif validated:
            with suppress(StorageError):  # it would be told behind the validation, too
                self._write(trainer)
        self._between_steps = True

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save what the validation found along with the weights."""
        if not trainer.sanity_checking:
            self._write(trainer)
            self._keep(trainer)

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save what an end that nobody foresaw would lose."""
        if trainer.global_step > self._last:
            self._write(trainer)
            self._keep(trainer)

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Save the steps made before an error; weights that a broken step or a validation may have changed are not."""
        if isinstance(exception, KeyboardInterrupt):  # the second Ctrl-C: at once
            return
        step = trainer.global_step
        with suppress(Exception):  # the error that ends the fit is the one to tell
            # Several processes would wait for each other here.
            if self._between_steps and trainer.training and step > self._written and trainer.world_size == 1:
                self._write(trainer)
            if step == self._written:
                self._keep(trainer)

    def _write(self, trainer: Trainer) -> None:
        """Write the numbered checkpoint of this step."""
        self._between_steps = False  # if the writing fails, it would fail again
        trainer.save_checkpoint(self._numbered(trainer.global_step))
        self._written = trainer.global_step

    def _keep(self, trainer: Trainer) -> None:
        """Make the numbered checkpoint of this step `last.ckpt`, and remove the oldest ones."""
        if self._last == self._written and not trainer.validating:
            return
        self._last = self._written
        if not trainer.is_global_zero:
            return
        with atomic_path(self.directory / LAST) as temporary:
            # Not a second name of one file: what damages one leaves the other.
            shutil.copyfile(self._numbered(self._written), temporary)
        for old in newest_first(self.directory)[self.keep :]:
            old.unlink(missing_ok=True)

    def _numbered(self, step: int) -> Path:
        return self.directory / f"step{step:07d}.ckpt"


def validation_follows(trainer: Trainer) -> bool:
    """Return whether Lightning validates behind the step just made."""
    every = trainer.val_check_batch
    there = trainer.enable_validation and sum(trainer.num_val_batches) > 0
    return there and isinstance(every, int) and trainer.global_step % every == 0


class BestCheckpoint(Checkpoint):
    """Keeps `best.ckpt`: the checkpoint with the least of a validation's errors.

    Args:
        directory: folder of the run.
        monitor: name of the error, as it is logged. A rollout that fails is worse than any that does not.
    """

    def __init__(self, directory: str, monitor: str) -> None:
        self.path = Path(directory) / BEST
        self.monitor = monitor
        self.least: float | None = None
        self.step: int | None = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Begin anew where the folder has no best checkpoint, as one that a run is carried on in."""
        if not trainer.strategy.broadcast(self.path.is_file()):
            self.least = self.step = None

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save if there is none yet or this one is better."""
        if trainer.sanity_checking:
            return
        value = float(trainer.callback_metrics.get(self.monitor, math.nan))
        value = math.inf if math.isnan(value) else value
        if self.least is None or value < self.least:
            self.least, self.step = value, trainer.global_step
            trainer.save_checkpoint(self.path)

    def state_dict(self) -> dict[str, Any]:
        """Return the least error so far, and its step."""
        return {"least": self.least, "step": self.step}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the least error of the run that is resumed."""
        self.least, self.step = state_dict["least"], state_dict.get("step")


def best_checkpoint(trainer: Trainer) -> Path | None:
    """Return the best checkpoint of this run, None without a validation; a file of another run does not count."""
    callbacks = [callback for callback in trainer.callbacks if isinstance(callback, BestCheckpoint)]  # type: ignore[attr-defined]
    paths = [callback.path for callback in callbacks if callback.least is not None and callback.path.is_file()]
    return paths[0] if paths else None


def newest_first(directory: Path) -> list[Path]:
    """Return the numbered checkpoints of a run, the one written last first."""
    return sorted(directory.glob(NUMBERED), key=lambda path: (path.stat().st_mtime_ns, path.name), reverse=True)
