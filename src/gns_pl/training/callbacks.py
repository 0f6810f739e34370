"""What ends a run early without losing anything: a signal, or a loss that is not finite; and what skips a step."""

from __future__ import annotations

import io
import signal
import threading
from pathlib import Path
from typing import Any, cast

import torch
from lightning.pytorch import Callback, LightningModule, Trainer

from gns_pl.errors import InputError
from gns_pl.io.atomic import write_atomically
from gns_pl.training.checkpoints import LAST
from gns_pl.training.learning import LearningModule

ADVANCE_WARNINGS = ("SIGUSR1", "SIGUSR2", "SIGXCPU", "SIGHUP")
"""Signals by which batch systems (`sbatch --signal=USR1`) and closing terminals announce an end; they end a process."""


class StopAtSignal(Callback):
    """Ends the training behind the step that is being made, once it is saved, at Ctrl-C, SIGTERM or a batch system's.

    A second Ctrl-C ends it at once. Of several processes it is enough if one is told; all end behind the same step.

    Attributes:
        received: the signal, once there was one.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Take the signals over, from Lightning too, whose way of telling other processes can hang.

        Those of `ADVANCE_WARNINGS` are taken only if they would end the process: `nohup` ignores one, and the launchers
        of a sweep handle others themselves. Lightning gives all signals back at the end.
        """
        if threading.current_thread() is threading.main_thread():
            wanted = [signal.SIGINT, signal.SIGTERM] if trainer.is_global_zero else [signal.SIGTERM]
            known = [getattr(signal, name) for name in ADVANCE_WARNINGS if hasattr(signal, name)]
            wanted += [number for number in known if signal.getsignal(number) == signal.SIG_DFL]
            for number in wanted:
                signal.signal(number, self._note)

    def _note(self, number: int, frame: Any) -> None:
        if self.received is not None and number == signal.SIGINT:
            raise KeyboardInterrupt
        self.received = signal.Signals(number)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop if any process was told to."""
        stopped = trainer.strategy.reduce_boolean_decision(self.received is not None, all=False)
        if stopped and self.received is None:
            self.received = signal.SIGTERM
        if stopped:
            trainer.should_stop = True


class StopAtNonFinite(Callback):
    """Ends the training at a loss or at weights that are not finite, before they reach a checkpoint.

    On a CPU every step is looked at. Elsewhere that would make the host wait for the device, so the step of the first
    such loss is noted there and looked up whenever something is logged or saved.

    Args:
        directory: folder of the run, for the windows that the step was made of.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._first: torch.Tensor | None = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Note that no step was bad so far."""
        self._first = torch.tensor(-1, device=pl_module.device)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Note the first bad step that is not left out."""
        assert self._first is not None
        if outputs["skippable"]:
            return
        bad = ~outputs["joined"].isfinite() & (self._first < 0)
        self._first = torch.where(bad, trainer.global_step - 1, self._first)
        if self._first.device.type == "cpu" or trainer.global_step % cast(Any, trainer).log_every_n_steps == 0:
            self._look(trainer)

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        """Keep everything that is not finite from being saved."""
        self._look(trainer)
        if not bool(torch.stack([weight.isfinite().all() for weight in pl_module.parameters()]).all()):
            self._stop(trainer, trainer.global_step - 1, "the weights are")

    def _look(self, trainer: Trainer) -> None:
        first = -1 if self._first is None else int(self._first)
        if first >= 0:
            self._stop(trainer, first, "the loss is")

    def _stop(self, trainer: Trainer, step: int, what: str) -> None:
        """Save what the step was made of and end the training.

        Raises:
            InputError: always.
        """
        path = self.directory / f"not_finite_step{step:07d}.pt"
        if trainer.is_global_zero:
            # A loss that is not finite may come of weights that the step before has spoilt.
            datamodule = cast(Any, trainer).datamodule
            windows = {number: datamodule.windows_of_step(number) for number in range(max(0, step - 1), step + 1)}
            buffer = io.BytesIO()
            torch.save({"step": step, "seed": datamodule.seed, "windows": windows}, buffer)
            write_atomically(path, buffer.getbuffer())
        last = self.directory / LAST
        remark = f"; {last} is from before" if last.is_file() else ""
        raise InputError(
            f"{what} not finite in step {step}{remark}; the windows of this step and the one before are in {path}: "
            "look at them, or lower training.optimisation.learning_rate."
        )


MOST_SKIPPED = 20
"""So many steps in a row that are not finite end a training."""


class SkipNonFinite(Callback):
    """Leaves out steps whose gradients are not finite, where the module wants it: whole runs break now and then.

    The weights stay as they are and the optimiser sees nothing; the step counts, so that the next one has other scenes.
    All processes see the mean of their gradients, and leave out the same steps.

    Attributes:
        skipped: steps left out so far, over all starts.
    """

    def __init__(self) -> None:
        self.skipped = self._in_a_row = 0

    def state_dict(self) -> dict[str, Any]:
        """Return the counts."""
        return {"skipped": self.skipped, "in_a_row": self._in_a_row}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on counting."""
        self.skipped, self._in_a_row = state_dict["skipped"], state_dict["in_a_row"]

    def on_before_optimizer_step(self, trainer: Trainer, pl_module: LightningModule, optimizer: Any) -> None:
        """Take the gradients away if they are not finite.

        Raises:
            InputError: so were those of many steps before.
        """
        if not cast(LearningModule, pl_module).skips_non_finite:
            return
        gradients = [weight.grad for weight in pl_module.parameters() if weight.grad is not None]
        if bool(torch.stack([gradient.isfinite().all() for gradient in gradients]).all()):
            self._in_a_row = 0
        else:
            for weight in pl_module.parameters():
                weight.grad = None
            self.skipped += 1
            self._in_a_row += 1
        pl_module.log("skipped", float(self.skipped), batch_size=1)
        if self._in_a_row == MOST_SKIPPED:
            raise InputError(
                f"{MOST_SKIPPED} whole runs in a row were not finite, up to step {trainer.global_step}; lower "
                "training.rollout.learning_rate, or train longer before them."
            )
