"""The LightningModule: loss, optimiser, validation by rollout. It takes plain dicts, so a checkpoint rebuilds it."""

from __future__ import annotations

import math
from typing import Any, cast

import torch
from torch import Tensor
from torch.nn.functional import mse_loss, smooth_l1_loss
from torch_geometric.data import Data

from gns_pl.graph import ColumnMeans, SceneBatch, Surfaces, TrainingDistribution, WindowRandom
from gns_pl.metrics.summary import rollout_errors
from gns_pl.models.checkpoint import Checkpoint, checkpoint_entry
from gns_pl.models.registry import build_simulator
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.training.deposits import Deposits
from gns_pl.training.learning import LearningModule
from gns_pl.training.optimiser import MuonAndAdamW, forget
from gns_pl.training.outcomes import ERRORS
from gns_pl.training.perturbation import Perturbation
from gns_pl.training.symmetry import sample_symmetry
from gns_pl.training.unroll import unrolled_loss
from gns_pl.training.validation import STEP_SECONDS
from gns_pl.training.whole_runs import WholeRuns
from gns_pl.trajectory import Trajectory

ROLLOUT_WARMUP = 0.05
"""Share of the steps of whole runs in which the learning rate rises."""

ROLLOUT_VALIDATIONS = 10
"""The steps of whole runs are few and each changes much: so many validations in them at least."""


def static_of_batch(batch: Data) -> SceneBatch:
    """Return the time-independent tensors of a PyG batch of windows."""
    return SceneBatch(
        particle_type=batch.particle_type,
        material=batch.material,
        volume=batch.volume,
        lower=batch.lower,
        upper=batch.upper,
        gravity=batch.gravity,
        batch=batch.batch,
        surfaces=Surfaces.joined(batch.surfaces) if "surfaces" in batch else None,
    )


def learning_rate_factor(step: int, *, warmup_steps: int, num_steps: int, final_factor: float) -> float:
    """Return linear warm-up, then a cosine down to `final_factor` at `num_steps`."""
    if step < warmup_steps:
        return (step + 1) / warmup_steps
    progress = min(1.0, (step - warmup_steps) / max(1, num_steps - warmup_steps))
    return final_factor + (1 - final_factor) * 0.5 * (1 + math.cos(math.pi * progress))


class SimulatorModule(LearningModule):
    """Trains a `Simulator` on windows and validates it by rollouts.

    Args:
        model: `SimulatorConfig` as a dict, with "kind" if it is another than the usual simulator.
        data: specification of the data, stored in the checkpoint.
        optimisation: `Optimisation` as a dict.
        perturbation: `Perturbation` as a dict.
        rollout: `RolloutPhase` as a dict.
        particles_per_window: mean number of moved particles of a window of the training set.
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
        rollout: dict[str, Any],
        particles_per_window: float,
        seed: int,
        provenance: dict[str, Any],
    ) -> None:
        super().__init__()
        self.save_hyperparameters(logger=False)
        self.simulator = build_simulator(model)
        self.perturb = Perturbation(**perturbation)
        self.optimisation, self.rollout = optimisation, rollout
        self.first_rollout: int = optimisation["num_steps"] - rollout["num_steps"]
        self.whole_runs: WholeRuns | None = None  # needed from step `first_rollout` on
        self.deposits: Deposits | None = None  # validated by, where whole runs are trained on
        self.data = data
        self.particles_per_window = particles_per_window
        self.seed = seed
        self.provenance = provenance
        self.distribution: TrainingDistribution | None = None  # set once the statistics are; stored in the checkpoint

    @property
    def skips_non_finite(self) -> bool:
        """Whether this step makes whole runs."""
        return self.global_step >= self.first_rollout

    def loss(self, batch: Data) -> Tensor:
        """Return the loss of a step []: that of its windows, in the last steps that of whole runs too."""
        if not self.skips_non_finite:
            return self.window_loss(batch)
        assert self.whole_runs is not None
        step, trainer = self.global_step - self.first_rollout, self.trainer
        errors = self.whole_runs.errors(self.simulator, step, trainer.global_rank, trainer.world_size)
        joined = cast(Tensor, trainer.strategy.reduce(errors.detach().clone(), reduce_op="mean"))
        for name, error in zip(ERRORS, joined, strict=True):
            self.log(f"rollout/{name}", error, batch_size=1)
        weight = self.rollout["weights"]["windows"]
        loss = self.whole_runs.loss(errors)
        return loss + weight * self.window_loss(batch) if weight else loss

    def on_train_batch_start(self, batch: Any, batch_index: int) -> None:
        """Begin the steps of whole runs with an optimiser that remembers nothing of the others' gradients."""
        super().on_train_batch_start(batch, batch_index)
        if self.global_step == self.first_rollout:
            forget(self.trainer.optimizers[0])
        self._validate_often()

    def on_train_start(self) -> None:
        """Go on as often as a run was validated before it was resumed."""
        super().on_train_start()
        self._validate_often()

    def _validate_often(self) -> None:
        if self.skips_non_finite:
            often = max(1, self.rollout["num_steps"] // ROLLOUT_VALIDATIONS)
            self.trainer.val_check_batch = min(self.trainer.val_check_batch, often)

    def window_loss(self, batch: Data) -> Tensor:
        """Return the loss of a batch of windows [].

        The loss of a particle is the mean over the components of its normalised acceleration. Few particles at an
        impact have accelerations of ten times the others' and most of the squared error; the Huber loss (over delta:
        smooth L1) keeps the slow majority, which makes a collapse, in sight.

        The sum over the moved particles is divided by the number of windows times a constant, the mean number of
        particles of a window, not by the number of particles that happen to be in the batch. So a step's loss is an
        unbiased estimate of the loss of the whole set, in which every particle counts alike (a ratio of two sums of a
        random batch would not be), and it is additive: the mean of the gradients of several processes with equally many
        windows each is the gradient of the joined batch, whatever the windows' sizes.

        What particles next to each other have in common moves a flow, and drowns in what each has alone: where a weight
        is given to columns, the square of their mean errors is added, each as often as it has particles.
        """
        scenes = static_of_batch(batch)
        # A window's noise depends on the seed and its number alone: resumed or spread over processes, it is the same.
        random = WindowRandom(self.seed, batch.number, scenes.batch)
        length = self.simulator.config.input_sequence_length
        steps = self._unrolled(self.global_step)
        truth = batch.position[:, : length + steps]
        if self.optimisation["symmetry"]:
            truth, scenes = sample_symmetry(truth, scenes, random)
        history, future = truth[:, :length], truth[:, length:]
        history, goal = self.perturb(history, future[:, 0], scenes, random)
        moved, delta = scenes.moved, self.optimisation["huber_delta"]
        parts = future.shape[2] * batch.num_graphs * self.particles_per_window

        share = self.optimisation["column_weight"]
        over_columns = ColumnMeans(history[:, -1], scenes, self.simulator.config.connectivity_radius) if share else None

        def difference(predicted: Tensor, target: Tensor) -> Tensor:
            predicted, target = predicted[moved], target[moved]
            if delta is None:
                total = mse_loss(predicted, target, reduction="sum")
            else:
                total = smooth_l1_loss(predicted, target, beta=delta, reduction="sum")
            if over_columns is not None:
                total = total + share * over_columns.square(predicted - target)
            return cast(Tensor, total / parts)

        return unrolled_loss(
            self.simulator,
            history,
            goal,
            future,
            scenes,
            restore=self.perturb.restore,
            loss=difference,
        )

    def _unrolled(self, step: int) -> int:
        """Return how many steps in a row training step `step` makes."""
        settings = self.optimisation
        late = step >= settings["unroll_from"] * self.first_rollout
        return int(settings["unroll_steps"]) if late else 1

    def validation_step(self, reference: Trajectory | None, batch_index: int) -> dict[str, Any] | None:
        """Roll a whole validation trajectory out from its first frame, note its errors, and return it for figures."""
        if reference is None:
            self._validation.add(None)
            return None
        solver = LearnedSolver.of(Checkpoint(self.simulator, self.data, self.provenance))
        # Not monitored, so that a network that is not yet any good has errors too, and not only failures.
        predicted = solver.run(reference, num_steps=reference.num_frames - 1, monitor=False)
        seconds = cast(float, predicted.provenance["wall_seconds"]) / max(1, predicted.num_frames - 1)
        errors = {**rollout_errors(predicted, reference), STEP_SECONDS: seconds}
        if self.deposits is not None:
            number = self.trainer.global_rank + batch_index * self.trainer.world_size
            errors.update(self.deposits.squares(solver, number))
        self._validation.add(errors)
        return {"predicted": predicted}

    def configure_optimizers(self) -> Any:
        """Return the optimiser with warm-up and cosine, stepped every step."""
        settings = self.optimisation
        rate, decay = settings["learning_rate"], settings["weight_decay"]
        optimizer: torch.optim.Optimizer
        if settings["optimiser"] == "muon":
            optimizer = MuonAndAdamW(self, lr=rate, weight_decay=decay)
        else:
            optimizer = torch.optim.AdamW(self.parameters(), lr=rate, weight_decay=decay, fused=True)
        scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, self._rate)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": scheduler, "interval": "step"}}

    def _rate(self, step: int) -> float:
        """Return a step's learning rate over that of `optimisation`: it rises and falls, and anew for whole runs."""
        settings, rollout, first = self.optimisation, self.rollout, self.first_rollout
        final = settings["final_factor"]
        if step < first or not rollout["num_steps"]:
            return learning_rate_factor(
                step, warmup_steps=settings["warmup_steps"], num_steps=first, final_factor=final
            )
        warmup, number = math.ceil(ROLLOUT_WARMUP * rollout["num_steps"]), rollout["num_steps"]
        factor = learning_rate_factor(step - first, warmup_steps=warmup, num_steps=number, final_factor=final)
        return float(factor * rollout["learning_rate"] / settings["learning_rate"])

    def entry(self, provenance: dict[str, Any]) -> dict[str, Any]:
        """Return what `gns_pl.models.checkpoint` reads."""
        return checkpoint_entry(self.simulator, self.data, provenance, self.distribution)
