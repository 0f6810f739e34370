"""The LightningModule: loss, optimiser, validation by rollout. It takes plain dicts, so a checkpoint rebuilds it."""

from __future__ import annotations

import math
import time
from typing import Any, cast

import torch
from lightning.pytorch import LightningModule
from torch import Tensor
from torch.nn.functional import mse_loss, smooth_l1_loss
from torch_geometric.data import Data

from gns_pl.checkpoint import KEY, checkpoint_entry
from gns_pl.errors import InputError
from gns_pl.evaluation.metrics import rollout_errors
from gns_pl.graph import Static
from gns_pl.rollout import rollout
from gns_pl.simulator import Simulator, SimulatorConfig
from gns_pl.training.perturbation import Perturbation
from gns_pl.training.symmetry import sample_symmetry
from gns_pl.training.unroll import unrolled_loss
from gns_pl.trajectory import Trajectory

MONITORED = "position_error"
"""The error of validation rollouts that the progress bar shows and the best checkpoint is chosen by."""


def static_of_batch(batch: Data) -> Static:
    """Return the time-independent tensors of a PyG batch of windows."""
    return Static(
        particle_type=batch.particle_type,
        material=batch.material,
        volume=batch.volume,
        lower=batch.lower,
        upper=batch.upper,
        gravity=batch.gravity,
        batch=batch.batch,
    )


def learning_rate_factor(step: int, *, warmup_steps: int, num_steps: int, final_factor: float) -> float:
    """Return linear warm-up, then a cosine down to `final_factor` at `num_steps`."""
    if step < warmup_steps:
        return (step + 1) / warmup_steps
    progress = min(1.0, (step - warmup_steps) / max(1, num_steps - warmup_steps))
    return final_factor + (1 - final_factor) * 0.5 * (1 + math.cos(math.pi * progress))


class SimulatorModule(LightningModule):
    """Trains a `Simulator` on windows and validates it by rollouts.

    Args:
        model: `SimulatorConfig` as a dict.
        data: specification of the data, stored in the checkpoint.
        optimisation: `Optimisation` as a dict.
        perturbation: `Perturbation` as a dict.
        seed: of the noise.
        provenance: stored in the checkpoint.
    """

    def __init__(
        self,
        *,
        model: dict[str, Any],
        data: dict[str, Any],
        optimisation: dict[str, Any],
        perturbation: dict[str, Any],
        seed: int,
        provenance: dict[str, Any],
    ) -> None:
        super().__init__()
        self.save_hyperparameters(logger=False)
        self.simulator = Simulator(SimulatorConfig.from_dict(model))
        self.perturb = Perturbation(**perturbation)
        self.optimisation = optimisation
        self.data = data
        self.seed = seed
        self.provenance = provenance
        self._clock = (time.perf_counter(), 0)
        self._windows = 0

    def training_step(self, batch: Data, batch_index: int) -> Tensor:
        """Return the mean loss of the normalised acceleration over the moved particles.

        Few particles at an impact have accelerations of ten times the others' and most of the squared error; the
        Huber loss (over delta: smooth L1) keeps the slow majority, which makes a collapse, in sight.
        """
        static = static_of_batch(batch)
        # The noise depends on the seed and the step alone: a resumed run draws what an uninterrupted one would.
        generator = torch.Generator(device=self.device).manual_seed(self.seed * 1_000_003 + self.global_step)
        length = self.simulator.config.input_sequence_length
        steps = self._unrolled(self.global_step)
        history, future = batch.position[:, :length], batch.position[:, length : length + steps]
        if self.optimisation["symmetry"]:
            history, future, static = sample_symmetry(history, future, static, generator)
        history, goal = self.perturb(history, future[:, 0], static, generator)
        moved, delta = static.moved, self.optimisation["huber_delta"]

        def difference(predicted: Tensor, target: Tensor) -> Tensor:
            predicted, target = predicted[moved], target[moved]
            return mse_loss(predicted, target) if delta is None else smooth_l1_loss(predicted, target, beta=delta)

        loss = unrolled_loss(
            self.simulator, history, goal, future, static, restore=self.perturb.restore, loss=difference
        )
        self.log("loss", loss, prog_bar=True, batch_size=batch.num_graphs)
        self._windows += batch.num_graphs
        return loss

    def _unrolled(self, step: int) -> int:
        """Return how many steps in a row training step `step` makes."""
        settings = self.optimisation
        late = step >= settings["unroll_from"] * settings["num_steps"]
        return int(settings["unroll_steps"]) if late else 1

    def on_train_batch_end(self, outputs: Any, batch: Data, batch_index: int) -> None:
        """Log the pace now and then, and stop at a loss that is not finite."""
        if self.global_step % cast(Any, self.trainer).log_every_n_steps == 0:
            if not math.isfinite(float(outputs["loss"])):
                raise InputError(
                    f"the loss is {float(outputs['loss'])} after {self.global_step} steps; "
                    "lower training.optimisation.learning_rate."
                )
            now = time.perf_counter()
            before, windows = self._clock
            self.log("windows_per_s", (self._windows - windows) / (now - before), prog_bar=True, batch_size=1)
            self._clock = (now, self._windows)

    def validation_step(self, reference: Trajectory, batch_index: int) -> dict[str, Any]:
        """Roll a whole validation trajectory out from its first frame, log its errors, and return it for figures."""
        predicted = rollout(self.simulator, reference, reference.num_frames - 1)
        for name, value in rollout_errors(predicted, reference).items():
            if math.isnan(value) and name != MONITORED:
                continue  # not defined for this scene, or the rollout failed, which the monitored error shows
            self.log(f"valid/{name}", value, batch_size=1, prog_bar=name == MONITORED)
        seconds = cast(float, predicted.provenance["wall_seconds"]) / max(1, predicted.num_frames - 1)
        self.log("valid/rollout_step_seconds", seconds, batch_size=1)
        return {"predicted": predicted}

    def on_validation_epoch_end(self) -> None:
        """Leave the time of the rollouts out of the pace."""
        self._clock = (time.perf_counter(), self._windows)

    def configure_optimizers(self) -> Any:
        """Return AdamW with warm-up and cosine, stepped every step."""
        settings = self.optimisation
        optimizer = torch.optim.AdamW(
            self.parameters(), lr=settings["learning_rate"], weight_decay=settings["weight_decay"], fused=True
        )
        scheduler = torch.optim.lr_scheduler.LambdaLR(
            optimizer,
            lambda step: learning_rate_factor(
                step,
                warmup_steps=settings["warmup_steps"],
                num_steps=settings["num_steps"],
                final_factor=settings["final_factor"],
            ),
        )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": scheduler, "interval": "step"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add what `gns_pl.checkpoint` reads."""
        provenance = {**self.provenance, "steps": self.global_step}
        checkpoint[KEY] = checkpoint_entry(self.simulator.config, self.data, provenance)
