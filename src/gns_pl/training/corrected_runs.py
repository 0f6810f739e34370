"""Training of a corrector on whole runs: retuned coarse MPM with corrections, from a scene to the end of its flow.

What is compared is what all points of the fine run did (`outcomes`); derivatives go back through the run as
`straight_run` has them. No fine place is followed and nothing is labelled. Which scenes a step runs, how their points
are placed and in which symmetry the network sees them follows from the seed and the number of the step alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.graph import WindowRandom
from gns_pl.io import read_manifest
from gns_pl.models.checkpoint import FORMAT_VERSION
from gns_pl.models.corrector import Corrector, CorrectorConfig
from gns_pl.models.shipped import CORRECTOR_KIND
from gns_pl.mpm import SimulationError
from gns_pl.rollout import static_of
from gns_pl.solvers.correction import CoarseStart, corrected_run
from gns_pl.training.config import CorrectedRunsConfig
from gns_pl.training.deposits import deposit_errors
from gns_pl.training.followed import StepNumbers
from gns_pl.training.learning import LearningModule
from gns_pl.training.module import learning_rate_factor
from gns_pl.training.outcomes import ERRORS, compared_frames, outcome_errors
from gns_pl.training.straight import mirrored, straight_run
from gns_pl.training.symmetry import Symmetry
from gns_pl.training.validation import DEPOSIT, MONITORED
from gns_pl.training.whole_runs import FineRun, read_fine_run

WARMUP, FINAL = 0.05, 0.02
"""Share of the steps in which the learning rate rises, and share of it that is left at the end."""

FIRST_PLACEMENT = 1_000_000_000
"""Seed of the first placement in which a validation scene is judged; training draws others."""


class FineRuns(TrajectoryDataModule):
    """What all points of the fine runs of data sets did; its loader yields numbers of steps, and scenes to judge by.

    Args:
        directories: folders with a manifest, the first one's is that of the training.
        training: conf/training/corrected_runs.yaml.
        seed: of the order of scenes.
    """

    def __init__(self, directories: Sequence[Path], training: CorrectedRunsConfig, seed: int) -> None:
        super().__init__(
            directories[0],
            batch_size=training.scenes,
            num_steps=training.num_steps,
            input_sequence_length=1,
            num_targets=1,
            stride=training.stride,
            start_repeats=1,
            moving_repeats=1,
            num_workers=0,
            memory_limit=0,
            num_train=training.num_train,
            seed=seed,
        )
        manifests = [(directory, read_manifest(directory)) for directory in directories]
        train = [d / name for d, manifest in manifests for name in manifest.splits["train"][: training.num_train]]
        valid = [d / name for d, manifest in manifests for name in manifest.splits["valid"]]
        self.train_names, self.valid_names = tuple(map(str, train)), tuple(map(str, valid))
        self.train_set: list[FineRun] = [  # type: ignore[assignment]
            read_fine_run(path, self.stride) for path in train
        ]
        self.valid_set = [read_fine_run(path, self.stride) for path in valid]

    def setup(self, stage: str) -> None:
        """Do nothing: all is read."""

    def drawn(self, step: int) -> list[tuple[FineRun, int]]:
        """Return the runs of a step and the number of each in the training."""
        return [(self.train_set[index], number) for index, number in self._sampler().joined_batch(step)]

    def train_dataloader(self) -> DataLoader[int]:
        """Return the numbers of the steps still to make."""
        numbers: Any = range(self.num_steps)
        return DataLoader(numbers, sampler=StepNumbers(self._steps_made, self.num_steps), batch_size=None)

    def val_dataloader(self) -> DataLoader[int]:  # type: ignore[override]
        """Return the numbers of the validation scenes."""
        numbers: Any = range(len(self.valid_set))
        return DataLoader(numbers, batch_size=None)

    def windows_of_step(self, step: int) -> list[dict[str, Any]]:
        """Return what a step is made of as plain values."""
        return [{"scene": run.start.scene.name, "number": number} for run, number in self.drawn(step)]


class CorrectedRunsModule(LearningModule):
    """Errors of whole corrected runs; validation by the errors of their deposits.

    Args:
        model: `CorrectorConfig` as a dict.
        data: specification of the data, stored in the checkpoint.
        training: `CorrectedRunsConfig` as a dict.
        seed: of placements and symmetries.
        provenance: stored in the checkpoint.
    """

    def __init__(
        self,
        *,
        model: dict[str, Any],
        data: dict[str, Any],
        training: dict[str, Any],
        seed: int,
        provenance: dict[str, Any],
    ) -> None:
        super().__init__()
        self.save_hyperparameters(logger=False)
        self.corrector = Corrector(CorrectorConfig(**model))
        self.data, self.training_config, self.seed, self.provenance = data, training, seed, provenance

    @property
    def runs(self) -> FineRuns:
        """The data module of the fit."""
        return cast(FineRuns, cast(Any, self.trainer).datamodule)

    @property
    def skips_non_finite(self) -> bool:
        """Whole runs break now and then."""
        return True

    def loss(self, batch: int) -> Tensor:
        """Return the weighted errors of a step's runs []."""
        try:
            errors = torch.stack([self.errors(run, number) for run, number in self.runs.drawn(batch)]).mean(dim=0)
        except SimulationError:
            errors = torch.full((len(ERRORS),), math.nan) * sum(weight.sum() for weight in self.parameters())
        for name, error in zip(ERRORS, errors.detach(), strict=True):
            self.log(f"rollout/{name}", error, batch_size=1)
        weights = errors.new_tensor([self.training_config["weights"][name] for name in ERRORS])
        return (weights * errors).sum()

    def errors(self, run: FineRun, number: int) -> Tensor:
        """Return the errors of a corrected run [len(ERRORS)].

        Args:
            run: the fine one.
            number: of the run in the training, which decides placement and symmetry.
        """
        scene = run.start.scene
        start = CoarseStart.retuned(self.corrector.config, scene, self.seed * 1_000_003 + number, {})
        static = static_of(start.first)
        turn = Symmetry.sample(static, WindowRandom(self.seed, torch.tensor([number]), static.batch), torch.float32)
        frames = mirrored(straight_run(self.corrector, start, run.last, turn), scene, start.reduction.mirrors)
        return outcome_errors(frames, start.reduction.lift(start.first), run.fine, compared_frames(run.last, run.last))

    def validation_step(self, batch: int, batch_index: int) -> None:
        """Run a validation scene in some placements, and note the errors of its deposit."""
        fine, rows = self.runs.valid_set[batch], []
        for placement in range(self.training_config["placements"]):
            start = CoarseStart.retuned(self.corrector.config, fine.start.scene, FIRST_PLACEMENT + placement, {})
            try:
                run = start.reduction.lift(corrected_run(self.corrector, start, fine.last))
                errors = deposit_errors(run.every(fine.last), fine.fine)
            except SimulationError:
                errors = dict.fromkeys(DEPOSIT, math.inf)
            rows.append([errors[name] ** 2 for name in DEPOSIT])
        squares = np.mean(rows, axis=0).tolist()
        self._validation.add(dict(zip((f"{name}_square" for name in DEPOSIT), squares, strict=True)))

    def on_validation_epoch_end(self) -> None:
        """Log the errors of deposits over all scenes and placements."""
        for name, value in self._validation.means(self.trainer).items():
            if name != MONITORED:  # fine points are not those of the coarse run
                self.log(f"valid/{name}", value, batch_size=1)

    def configure_optimizers(self) -> Any:
        """Return AdamW with warm-up and cosine."""
        number, rate = self.training_config["num_steps"], self.training_config["learning_rate"]
        optimiser = torch.optim.AdamW(self.corrector.parameters(), lr=rate, weight_decay=0.0)
        factor = partial(
            learning_rate_factor, warmup_steps=math.ceil(WARMUP * number), num_steps=number, final_factor=FINAL
        )
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, factor)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def entry(self, provenance: dict[str, Any]) -> dict[str, Any]:
        """Return what `load_corrector` reads besides the weights."""
        config = asdict(self.corrector.config)
        entry = {"format_version": FORMAT_VERSION, "kind": CORRECTOR_KIND, "config": config}
        return entry | {"data": self.data, "provenance": provenance}


def velocity_scale(runs: Sequence[FineRun]) -> float:
    """Return the root mean square of a velocity component over all frames of fine runs [m/s]."""
    squares = [2 * run.fine.kinetic_energy / run.start.mass.sum() / run.start.scene.dim for run in runs]
    return float(np.sqrt(np.concatenate(squares).mean()))
