"""What `train` has to know of what is trained, so that everything else about a training is the same."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from lightning.pytorch import Trainer

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.training.learning import LearningModule


class Recipe(ABC):
    """Settings, checked before anything is generated, and what is built of them once the data are there.

    Attributes:
        num_steps: training steps in all.
        batch_size: windows per step, of all processes together.
    """

    num_steps: int
    batch_size: int

    @abstractmethod
    def build(self, directory: Path, trainer: Trainer) -> tuple[LearningModule, TrajectoryDataModule]:
        """Return module and data module of a dataset folder, ready to fit.

        Raises:
            InputError: data or devices that cannot be used.
        """

    def export(self, checkpoint: Path, output: Path) -> list[Path]:
        """Write into the run's folder what a checkpoint is used as; simulators' checkpoints are used as they are."""
        return []
