"""Which checkpoints a run keeps, and how they get onto the disk: whole or not at all."""

from __future__ import annotations

import io
import math
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint

from gns_pl.errors import InputError
from gns_pl.io.atomic import atomic_path, write_atomically

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
    """Keeps `last.ckpt` of a run and the few before it: every so many steps, at the end, and when the run is stopped.

    Lightning calls checkpoint callbacks after all others, so the average that is saved has taken the step in.
    If a validation follows, the checkpoint is written behind it: a resumed run does not miss a validation.

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

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save if it is time to, or if the run is being stopped."""
        step, every = trainer.global_step, trainer.val_check_batch
        validated = trainer.enable_validation and isinstance(every, int) and step % every == 0
        if trainer.should_stop and not validated:
            trainer.limit_val_batches = 0  # or Lightning would validate where an uninterrupted run does not
        due = step % self.every_n_steps == 0 or step == trainer.max_steps
        if trainer.should_stop or (due and not validated):
            self._save(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save what the validation found along with the weights."""
        self._save(trainer)

    def _save(self, trainer: Trainer) -> None:
        path = self.directory / f"step{trainer.global_step:07d}.ckpt"
        trainer.save_checkpoint(path)
        if not trainer.is_global_zero:
            return
        with atomic_path(self.directory / LAST) as temporary:
            shutil.copyfile(path, temporary)  # not a second name of one file: what damages one leaves the other
        for old in newest_first(self.directory)[self.keep :]:
            old.unlink(missing_ok=True)


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

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Begin anew where the folder has no best checkpoint, as one that a run is carried on in."""
        if not trainer.strategy.broadcast(self.path.is_file()):
            self.least = None

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save if there is none yet or this one is better."""
        value = float(trainer.callback_metrics.get(self.monitor, math.nan))
        value = math.inf if math.isnan(value) else value
        if self.least is None or value < self.least:
            self.least = value
            trainer.save_checkpoint(self.path)

    def state_dict(self) -> dict[str, Any]:
        """Return the least error so far."""
        return {"least": self.least}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the least error of the run that is resumed."""
        self.least = state_dict["least"]


def newest_first(directory: Path) -> list[Path]:
    """Return the numbered checkpoints of a run, the one written last first."""
    return sorted(directory.glob(NUMBERED), key=lambda path: (path.stat().st_mtime_ns, path.name), reverse=True)
