"""What every training does alike, whatever is learned: the loss of a step, errors of a validation, a checkpoint."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, cast

import torch
from lightning.pytorch import LightningModule
from torch import Tensor

from gns_pl.models.checkpoint import KEY
from gns_pl.training.clock import Stopwatch
from gns_pl.training.validation import MONITORED, ValidationTable


class LearningModule(LightningModule):
    """A LightningModule whose steps, validations and checkpoints the callbacks of conf/callbacks read.

    Attributes:
        provenance: stored in the checkpoint, with the resolved config.
    """

    provenance: dict[str, Any]

    @property
    def skips_non_finite(self) -> bool:
        """Whether the step that is made is left out, and does not end the training, if it is not finite."""
        return False

    @abstractmethod
    def loss(self, batch: Any) -> Tensor:
        """Return the loss of what the data module yields for a step []."""

    @abstractmethod
    def entry(self, provenance: dict[str, Any]) -> dict[str, Any]:
        """Return what a checkpoint stores under `gns_pl.models.checkpoint.KEY`, plain values and tensors only."""

    def training_step(self, batch: Any, batch_index: int) -> dict[str, Any]:
        """Return "loss", that of this process's windows, "joined", that of all processes' windows, and "skippable"."""
        loss = self.loss(batch)
        joined = self.trainer.strategy.reduce(loss.detach().clone(), reduce_op="mean")
        self.log("loss", joined, prog_bar=True, batch_size=1)
        return {"loss": loss, "joined": cast(Tensor, joined), "skippable": self.skips_non_finite}

    def on_train_batch_start(self, batch: Any, batch_index: int) -> None:
        """Begin with the weights of the training again."""
        self._say_that_weights_changed()

    def on_validation_epoch_start(self) -> None:
        """Begin a new table of errors."""
        self._say_that_weights_changed()
        self._validation = ValidationTable()

    def _say_that_weights_changed(self) -> None:
        """Have what `nn` packs of weights packed anew: Lightning swaps an average in and out, unseen by autograd."""
        torch.autograd.graph.increment_version(list(self.parameters()))

    def on_validation_epoch_end(self) -> None:
        """Log the means over all trajectories."""
        for name, value in self._validation.means(self.trainer).items():
            self.log(f"valid/{name}", value, batch_size=1, prog_bar=name == MONITORED, sync_dist=True)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add the entry, with steps and time so far."""
        provenance = {**self.provenance, "steps": self.global_step}
        clocks = [each for each in self.trainer.callbacks if isinstance(each, Stopwatch)]  # type: ignore[attr-defined]
        if "cost" in provenance and clocks:
            provenance["cost"] = {**provenance["cost"], "train_seconds": clocks[0].seconds}
        checkpoint[KEY] = self.entry(provenance)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Forget the time that earlier starts took: `trainer.max_time` is that of each start."""
        checkpoint["callbacks"].pop("Timer", None)
