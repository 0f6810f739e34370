"""What happens beside the training steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer

from gns_pl.io import atomic_path


class LastCheckpoint(Callback):
    """Keeps `last.ckpt` of a run: every so many steps and after the last one. It must stand behind the averaging.

    Args:
        directory: folder of the run.
        every_n_steps: steps that a killed run loses at most.
    """

    def __init__(self, directory: str, every_n_steps: int) -> None:
        self.path = Path(directory) / "last.ckpt"
        self.every_n_steps = every_n_steps

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save, whole or not at all: a kill leaves the one before."""
        if trainer.global_step % self.every_n_steps == 0 or trainer.global_step == trainer.max_steps:
            with atomic_path(self.path) as temporary:
                trainer.save_checkpoint(temporary)
