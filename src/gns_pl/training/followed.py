"""What a `Corrector` learns from: coarse runs that follow fine trajectories, frame by frame, and what they miss.

The examples are kept in memory. At every validation a share of the runs is made anew and led by the network in part, so
that it learns to lead back from where it goes astray. What was renewed by which weights is part of the checkpoint, so a
resumed run has the same examples.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Sampler

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.metrics.curves import compute_curves
from gns_pl.models.corrector import Corrector
from gns_pl.mpm import SimulationError
from gns_pl.solvers.correction import followed_run
from gns_pl.training.config import CorrectionConfig
from gns_pl.trajectory import Trajectory

Floats = NDArray[np.float32]

LEAST_MOTION = 0.1
"""A frame in which no point is faster than this share of the velocity scale teaches nothing."""

SHARES = (0.6, 1.0)
"""Of the missing velocity that is given in the first runs, in turn (`followed_run`)."""

LEAST_RUNOUT = 0.5
"""A fine run that runs out by less, in lengths of its body, is no column."""


class Example(NamedTuple):
    """A frame of a coarse run: positions as `Corrector` takes them [N, D] [m], and the wanted velocity [N, D] [m/s]."""

    run: int
    before: Floats
    position: Floats
    predicted: Floats
    velocity: Floats


def make_examples(
    run: int, fine: Trajectory, corrector: Corrector, *, share: float = 1.0, position_gain: float, policy_mix: float = 0
) -> list[Example]:
    """Return what coarse run number `run` misses of a fine trajectory; the other arguments as `followed_run`."""
    steps = followed_run(fine, corrector, share=share, position_gain=position_gain, policy_mix=policy_mix)
    return [Example(run, *arrays) for arrays in steps]


def fit_scales(corrector: Corrector, examples: Sequence[Example]) -> None:
    """Set the normalisation of a corrector."""
    interval = corrector.config.interval
    corrector.velocity_scale.fill_(_rms([(each.predicted - each.position) / interval for each in examples]))
    corrector.correction_scale.fill_(_rms([each.velocity for each in examples]))


def _rms(values: Sequence[Floats]) -> float:
    squares = sum(float(torch.from_numpy(each).double().square().sum()) for each in values)
    return math.sqrt(squares / sum(each.size for each in values))


def is_column(fine: Trajectory) -> bool:
    """Return whether enough of a trajectory runs out to judge a corrector by."""
    return bool(compute_curves(fine)["runout_99"][-1] > LEAST_RUNOUT)


class StepNumbers(Sampler[int]):
    """The numbers of the steps of a training that are still to make; its length is that of the whole training."""

    def __init__(self, first: int, num_steps: int) -> None:
        self.first, self.num_steps = first, num_steps

    def __len__(self) -> int:
        return self.num_steps

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.first, self.num_steps))


class FollowedRuns(TrajectoryDataModule):
    """Examples of coarse runs for training, whole fine trajectories for validation.

    Its loader yields numbers of steps, and the examples of a step are looked up when it is made (`examples_of`), since
    a validation renews them. Call `follow` before the fit.

    Args:
        directory: folder with a manifest.
        training: conf/training/correction.yaml.
        seed: stored with what a broken step was made of.
    """

    def __init__(self, directory: Path, training: CorrectionConfig, seed: int) -> None:
        super().__init__(
            directory,
            batch_size=training.batch_size,
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
        if not self.train_names:
            raise InputError(f"{directory}: there is nothing to train on.")
        self.training = training
        self._renewed: dict[int, tuple[int, float]] = {}  # run → step and policy mix with which it was made last
        self._weights: dict[int, dict[str, Tensor]] = {}  # step → weights of the corrector that led runs then
        self._order_from = 0  # step at which the order of the examples was drawn last

    def setup(self, stage: str) -> None:
        """Do nothing: `follow` has read the trajectories."""

    def check_validation(self) -> None:
        """Check the validation trajectories.

        Raises:
            InputError: as `TrajectoryDataModule`, or none of them can choose the weights.
        """
        super().check_validation()
        if not any(is_column(read_trajectory(self.directory / name).every(self.stride)) for name in self.valid_names):
            raise InputError(
                f"{self.directory}: no validation trajectory runs out, so none can choose the weights; hold one out, "
                "or train without a validation: add trainer.limit_val_batches=0."
            )

    def follow(self, corrector: Corrector) -> None:
        """Make the first examples, and set the scales of the corrector by them.

        Args:
            corrector: whose coarse runs follow; its weights play no part.
        """
        self.fine = [read_trajectory(self.directory / name).every(self.stride) for name in self.train_names]
        gain = self.training.position_gain
        self.examples = [
            make_examples(run, fine, corrector, share=SHARES[run % len(SHARES)], position_gain=gain)
            for run, fine in enumerate(self.fine)
        ]
        fit_scales(corrector, [example for examples in self.examples for example in examples])
        self._corrector = copy.deepcopy(corrector).eval()
        self._choose()

    def _choose(self) -> None:
        """List the examples in which something moves."""
        least = LEAST_MOTION * float(self._corrector.velocity_scale) * self._corrector.config.interval
        self.train_set: list[Example] = [  # type: ignore[assignment]
            example
            for examples in self.examples
            for example in examples
            if float(np.abs(example.predicted - example.position).max()) > least
        ]

    def examples_of(self, step: int) -> list[Example]:
        """Return the examples of a step, drawn by its number alone; none for one before the last validation."""
        count = (step - self._order_from + 1) * self.batch_size
        if count <= 0:
            return []
        order = np.random.default_rng(self._order_from + 1).integers(0, len(self.train_set), count)
        return [self.train_set[index] for index in order[-self.batch_size :]]

    def renew(self, weights: Mapping[str, Tensor], step: int) -> None:
        """Make a share of the runs anew, and draw the order of the examples anew.

        Args:
            weights: of the corrector that leads them in part.
            step: steps made; which runs, and how much of them, depends on it alone.
        """
        draw = np.random.default_rng(step)
        chosen = np.flatnonzero(draw.random(len(self.fine)) < self.training.refresh_fraction)
        self._weights[step], self._order_from = dict(weights), step
        for run in chosen.tolist():
            with suppress(SimulationError):  # a run that breaks teaches nothing; the one before stays
                self._lead(run, step, float(draw.random()))
        in_use = {made for made, _ in self._renewed.values()}
        self._weights = {made: kept for made, kept in self._weights.items() if made in in_use}
        self._choose()

    def _lead(self, run: int, step: int, policy_mix: float) -> None:
        """Make a run anew with the weights of a step."""
        self._corrector.load_state_dict(self._weights[step])
        gain = self.training.position_gain
        self.examples[run] = make_examples(
            run, self.fine[run], self._corrector, position_gain=gain, policy_mix=policy_mix
        )
        self._renewed[run] = (step, policy_mix)

    def train_dataloader(self) -> DataLoader[int]:
        """Return the numbers of the steps still to make."""
        numbers: Any = range(self.num_steps)
        return DataLoader(numbers, sampler=StepNumbers(self._steps_made, self.num_steps), batch_size=None)

    def windows_of_step(self, step: int) -> list[dict[str, Any]]:
        """Return the examples of a step as plain values and tensors."""
        return [
            {
                name: torch.from_numpy(value) if isinstance(value, np.ndarray) else self.train_names[value]
                for name, value in example._asdict().items()
            }
            for example in self.examples_of(step)
        ]

    def state_dict(self) -> dict[str, Any]:
        """Return the steps made, and with which weights runs were made anew."""
        renewed = {run: list(made) for run, made in self._renewed.items()}
        return super().state_dict() | {
            "order_from": self._order_from,
            "renewed": renewed,
            "weights": self._weights,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on behind the steps made, with the same examples."""
        super().load_state_dict(state_dict)
        self._order_from, self._weights = state_dict["order_from"], state_dict["weights"]
        for run, (step, policy_mix) in state_dict["renewed"].items():
            self._lead(run, step, policy_mix)
        self._choose()
