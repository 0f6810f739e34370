"""The numbers of conf/training, checked before anything is generated or read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from gns_pl.errors import InputError
from gns_pl.training.optimiser import OPTIMISERS
from gns_pl.training.outcomes import ERRORS
from gns_pl.training.perturbation import Perturbation


@dataclass(frozen=True)
class Optimisation:
    """How the weights are fitted.

    Attributes:
        num_steps: training steps in all.
        optimiser: "adamw", or "muon" for the matrices and AdamW for the rest (`training.optimiser`).
        learning_rate: its largest value, after the warm-up.
        final_factor: share of it that is left at the end.
        weight_decay: of the optimiser.
        warmup_steps: linear rise of the learning rate.
        column_weight: of the squared errors of means over columns (`graph.ColumnMeans`), beside each particle's own.
        huber_delta: of the loss, in units of the acceleration scale; None for the mean squared error.
        symmetry: mirror and exchange the horizontal axes at random.
        unroll_steps: steps in a row that the loss follows, late in training.
        unroll_from: share of the training after which it does; before, it is one step.

    Raises:
        InputError: a value out of range.
    """

    num_steps: int
    optimiser: str
    learning_rate: float
    final_factor: float
    weight_decay: float
    warmup_steps: int
    column_weight: float
    huber_delta: float | None
    symmetry: bool
    unroll_steps: int
    unroll_from: float

    def __post_init__(self) -> None:
        _check("training.optimisation", self, num_steps=1, warmup_steps=0, unroll_steps=1)
        _check("training.optimisation", self, unroll_from=0.0, column_weight=0.0)
        _check("training.optimisation", self, learning_rate=0.0, final_factor=0.0, weight_decay=0.0)
        if self.optimiser not in OPTIMISERS:
            raise InputError(
                f"training.optimisation.optimiser must be one of {', '.join(OPTIMISERS)}, not {self.optimiser!r}."
            )
        if self.huber_delta is not None:
            _check("training.optimisation", self, huber_delta=1e-6)


@dataclass(frozen=True)
class RolloutPhase:
    """How whole runs are compared with whole fine runs, in the last steps of a training (`training.whole_runs`).

    Attributes:
        num_steps: the last so many training steps; 0 for none.
        scenes: rolled out in every one of them, by all devices together.
        learning_rate: its largest value in these steps.
        whole_from: share of these steps after which runs are whole; before, their length grows.
        placements: fillings of every validation scene, which is judged by its deposit (`training.deposits`).
        weights: of the errors of a run, `training.outcomes.ERRORS`, and of "windows", the usual loss beside.

    Raises:
        InputError: an unknown or missing key, or a value out of range.
    """

    num_steps: int
    scenes: int
    learning_rate: float
    whole_from: float
    placements: int
    weights: Mapping[str, float]

    def __post_init__(self) -> None:
        owner = "training.rollout"
        _check(owner, self, num_steps=0, scenes=1, placements=1, learning_rate=0.0, whole_from=0.0)
        if self.whole_from > 1:
            raise InputError(
                f"{owner}.whole_from is a share of the steps, and must be at most 1, not {self.whole_from}."
            )
        _check_keys(f"{owner}.weights", self.weights, {*ERRORS, "windows"})
        _check(f"{owner}.weights", SimpleNamespace(**self.weights), **dict.fromkeys(self.weights, 0.0))
        if not any(self.weights[name] for name in ERRORS):
            raise InputError(f"{owner}.weights: one of {', '.join(ERRORS)} must be above 0.")


@dataclass(frozen=True)
class TrainingConfig:
    """Everything in conf/training.

    Attributes:
        batch_size: windows per step.
        num_workers: loader processes.
        memory_limit: a larger training set is read window by window [bytes].
        num_train: training trajectories; None for all.
        stride: frames of the data in a step of the simulator.
        start_repeats: how often a pass shows the windows while a trajectory sets out, up to its largest kinetic energy.
        moving_repeats: how often a pass shows the windows in which something moves.
        perturbation: noise.
        optimisation: the fit.
        rollout: its last steps.

    Raises:
        InputError: an unknown or missing key, or a value out of range.
    """

    batch_size: int
    num_workers: int
    memory_limit: float
    num_train: int | None
    stride: int
    start_repeats: int
    moving_repeats: int
    perturbation: Perturbation
    optimisation: Optimisation
    rollout: RolloutPhase

    def __post_init__(self) -> None:
        _check("training", self, batch_size=1, num_workers=0, stride=1, start_repeats=1, moving_repeats=1)
        _check("training", self, memory_limit=0.0)
        if self.num_train is not None:
            _check("training", self, num_train=1)
        if self.rollout.num_steps > self.optimisation.num_steps:
            raise InputError(
                f"training.rollout.num_steps is {self.rollout.num_steps}, more than all steps of the training, "
                f"training.optimisation.num_steps={self.optimisation.num_steps}."
            )
        if self.rollout.num_steps and not self.optimisation.learning_rate > 0:
            raise InputError("training.optimisation.learning_rate must be above 0 where training.rollout has steps.")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrainingConfig:
        """Build the config from conf/training's plain form, in which the noise is not nested."""
        noise = [field.name for field in dataclasses.fields(Perturbation)]
        known = {field.name for field in dataclasses.fields(cls)} - {"perturbation"} | set(noise)
        _check_keys("training", data, known)
        parts = {"optimisation": Optimisation, "rollout": RolloutPhase}
        for name, part in parts.items():
            _check_keys(f"training.{name}", data[name], {field.name for field in dataclasses.fields(part)})
        rest = {key: value for key, value in data.items() if key not in noise and key not in parts}
        return cls(
            perturbation=Perturbation(**{key: data[key] for key in noise}),
            optimisation=Optimisation(**data["optimisation"]),
            rollout=RolloutPhase(**data["rollout"]),
            **rest,
        )


@dataclass(frozen=True)
class CorrectionConfig:
    """Everything in conf/training/correction.yaml.

    Attributes:
        batch_size: examples per step, each a frame of a run.
        stride: frames of the data between corrections.
        num_train: training trajectories; None for all.
        position_gain: share of what positions are behind that is caught up in an interval (`followed_run`).
        refresh_fraction: share of the runs that is made anew at every validation, by the network itself in part.
        num_steps: training steps in all.
        learning_rate: its largest value; it rises and falls over all steps (Smith 2018).

    Raises:
        InputError: an unknown or missing key, or a value out of range.
    """

    batch_size: int
    stride: int
    num_train: int | None
    position_gain: float
    refresh_fraction: float
    num_steps: int
    learning_rate: float

    def __post_init__(self) -> None:
        _check("training", self, batch_size=1, stride=1, position_gain=0.0, refresh_fraction=0.0)
        _check("training.optimisation", self, num_steps=1, learning_rate=1e-12)
        if self.num_train is not None:
            _check("training", self, num_train=1)
        if self.refresh_fraction > 1:
            raise InputError(f"training.refresh_fraction must be at most 1, not {self.refresh_fraction}.")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CorrectionConfig:
        """Build the config from conf/training/correction.yaml's plain form."""
        return cls(**_unnested(cls, data))


@dataclass(frozen=True)
class CorrectedRunsConfig:
    """Everything in conf/training/corrected_runs.yaml.

    Attributes:
        scenes: run in every step.
        stride: frames of the data between corrections.
        num_train: training trajectories of every data set; None for all.
        placements: in which every validation scene is judged.
        weights: of the errors of a run, `training.outcomes.ERRORS`.
        num_steps: training steps in all.
        learning_rate: its largest value, after the warm-up.

    Raises:
        InputError: a value out of range.
    """

    scenes: int
    stride: int
    num_train: int | None
    placements: int
    weights: Mapping[str, float]
    num_steps: int
    learning_rate: float

    def __post_init__(self) -> None:
        _check("training", self, scenes=1, stride=1, placements=1)
        _check("training.optimisation", self, num_steps=1, learning_rate=1e-12)
        if self.num_train is not None:
            _check("training", self, num_train=1)
        _check_keys("training.weights", self.weights, set(ERRORS))
        _check("training.weights", SimpleNamespace(**self.weights), **dict.fromkeys(self.weights, 0.0))
        if not any(self.weights.values()):
            raise InputError(f"training.weights: one of {', '.join(ERRORS)} must be above 0.")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CorrectedRunsConfig:
        """Build the config from conf/training/corrected_runs.yaml's plain form."""
        return cls(**_unnested(cls, data))


def _unnested(config: type, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a plain form in which steps and learning rate stand under `optimisation`."""
    nested = {"num_steps", "learning_rate"}
    known = {field.name for field in dataclasses.fields(config)} - nested | {"optimisation"}
    _check_keys("training", data, known)
    _check_keys("training.optimisation", data["optimisation"], nested)
    return {**{key: data[key] for key in known - {"optimisation"}}, **data["optimisation"]}


def _check_keys(owner: str, data: Mapping[str, Any], known: set[str]) -> None:
    unknown, missing = sorted(set(data) - known), sorted(known - set(data))
    if unknown or missing:
        what = f"unknown key {', '.join(unknown)}" if unknown else f"missing key {', '.join(missing)}"
        raise InputError(f"{owner}: {what}; known are {', '.join(sorted(known))}.")


def _check(owner: str, config: object, **least: float) -> None:
    """Raise an `InputError` unless each named attribute is a number of its bound's kind, and at least the bound."""
    for name, bound in least.items():
        value = getattr(config, name)
        whole = isinstance(bound, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float) or not value >= bound:
            raise InputError(
                f"{owner}.{name} must be a {'whole ' if whole else ''}number of at least {bound:g}, not {value!r}."
            )
