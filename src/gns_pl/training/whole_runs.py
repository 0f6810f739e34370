"""Training on whole runs: from the cold start that a user gets to the end, against what all points of the fine run did.

A network that makes every step well may still make runs that are short, since the points that a data set keeps are not
the whole run and small common errors add up. Here a run is made as `LearnedSolver` makes it, stabilised as far as
that has derivatives (`TRAINED`), and those of its errors (`outcomes`) go back through all steps (`rollout.gradient`).

Which scenes a step rolls out, and how they are filled, follows from the seed and the number of the step alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gns_pl.data.sampler import StepSampler
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.generation import is_imported
from gns_pl.graph import WindowRandom
from gns_pl.io import read_observables, read_trajectory
from gns_pl.models.checkpoint import Checkpoint
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import static_of
from gns_pl.rollout.gradient import differentiable_rollout
from gns_pl.rollout.policy import Policy
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.training.config import RolloutPhase
from gns_pl.training.outcomes import COMPARED, ERRORS, compared_frames, outcome_errors
from gns_pl.training.symmetry import Symmetry
from gns_pl.trajectory import Observables, Trajectory

TRAINED = {"energy_limiter": False, "sleep": 0.02}
"""What stabilises these runs otherwise than others (conf/rollout/stable.yaml). Neither the halt of a scene whose energy
would rise nor sleep has a derivative: a network that once began a column so was held at rest by them and never learned
to let it go. Instead a rise of the energy is an error (`outcomes`), and what is slower than a fifth sleeps [m/s]."""


@dataclass(frozen=True)
class FineRun:
    """A scene of the training set.

    Attributes:
        start: its first frame, with its scene.
        fine: what all points of the fine run did, in frames one step of the simulator apart.
    """

    start: Trajectory
    fine: Observables

    @property
    def last(self) -> int:
        """Number of the last frame."""
        return len(self.fine.front) - 1


def read_fine_run(path: Path, stride: int) -> FineRun:
    """Read a trajectory file.

    Args:
        path: of the file.
        stride: frames of the file in a step.

    Raises:
        InputError: it lacks the observables of the whole run, or has kinematic particles.
    """
    start, fine = read_trajectory(path, num_frames=1), read_observables(path)
    if fine is None:
        raise InputError(
            f"{path}: has no observables of the whole run, which training.rollout and valid/deposit_error compare "
            "with; make the data set anew in another folder (data.root=…), or set training.rollout.num_steps=0 and "
            "callbacks.best.monitor=valid/position_error."
        )
    if (start.particle_type == ParticleType.KINEMATIC).any():
        raise InputError(f"{path}: has kinematic particles, and training.rollout knows no script of theirs.")
    return FineRun(replace(start, dt=start.dt * stride), fine.every(stride))


class WholeRuns:
    """The runs of the last steps of a training.

    Args:
        runs: of the training set.
        phase: conf/training, rollout.
        data: specification of the data, which says how scenes are filled.
        symmetry: mirror and exchange the horizontal axes at random.
        seed: of the order of scenes, of their filling and of symmetries.
    """

    def __init__(
        self,
        runs: Sequence[FineRun],
        phase: RolloutPhase,
        data: Mapping[str, Any],
        *,
        symmetry: bool,
        seed: int,
    ) -> None:
        self.runs, self.phase, self.data, self.symmetry, self.seed = runs, phase, data, symmetry, seed
        self._sampler = StepSampler(
            num_windows=len(runs), batch_size=phase.scenes, num_steps=phase.num_steps, seed=seed
        )

    def drawn(self, step: int, rank: int, num_ranks: int) -> list[tuple[FineRun, int]]:
        """Return a process's scenes of a step and the number of each in the training; arguments as of `errors`."""
        share = self.phase.scenes // num_ranks
        own = self._sampler.joined_batch(step)[rank * share : (rank + 1) * share]
        return [(self.runs[index], number) for index, number in own]

    def start(self, simulator: Simulator, run: FineRun, number: int) -> Trajectory:
        """Return the start of a run: a filling as users get it, or the first frame of what was imported."""
        if is_imported(self.data):
            return run.start
        solver = LearnedSolver.of(Checkpoint(simulator, dict(self.data), {}))
        return solver.start(run.start.scene, self.seed * 1_000_003 + number)

    def length(self, run: FineRun, step: int) -> int:
        """Return the steps that are made of a run: all; while lengths grow a share of all, a tenth at least."""
        grown = (step + 1) / max(1.0, self.phase.whole_from * self.phase.num_steps)
        return max(1, math.ceil(run.last * min(1.0, max(1 / COMPARED, grown))))

    def errors(self, simulator: Simulator, step: int, rank: int = 0, num_ranks: int = 1) -> Tensor:
        """Return the errors of a step's runs, means over this process's scenes [len(ERRORS)]; NaN where a run broke.

        Args:
            simulator: makes the steps.
            step: from 0 on, of those in which runs are made.
            rank: this process.
            num_ranks: processes.
        """
        chosen = self.drawn(step, rank, num_ranks)
        starts = [self.start(simulator, run, number) for run, number in chosen]
        lengths = [self.length(run, step) for run, _ in chosen]
        scenes = static_of(*starts, config=simulator.config).to(simulator.device)
        position = torch.cat([torch.from_numpy(start.position[0]) for start in starts]).to(simulator.device)
        velocity = torch.cat([torch.from_numpy(start.initial_velocity) for start in starts]).to(simulator.device)
        numbers = torch.tensor([number for _, number in chosen], device=simulator.device)
        turn, turned = None, scenes
        if self.symmetry:
            turn = Symmetry.sample(scenes, WindowRandom(self.seed, numbers, scenes.batch), position.dtype)
            position = turn.turned(position[:, None], scenes.batch)[:, 0]
            velocity = turn.turned(velocity[:, None], scenes.batch, vectors=True)[:, 0]
            turned = turn.scenes(scenes)
        # The shorter runs go on beside the longest one; what they do there has no errors.
        settings = {**Policy().stabilise, **TRAINED}
        frames = differentiable_rollout(simulator, position, velocity, turned, max(lengths), stabilised=settings)
        if not bool(torch.isfinite(frames[-1].detach()).all()):
            nothing = torch.stack([parameter.sum() for parameter in simulator.parameters()]).sum()
            return nothing * torch.full((len(ERRORS),), math.nan, device=frames.device)
        if turn is not None:
            frames = turn.undone(frames.transpose(0, 1), scenes.batch).transpose(0, 1)
        parts = torch.split(frames, [start.num_particles for start in starts], dim=1)
        errors = [
            outcome_errors(part, start, run.fine, compared_frames(run.last, length))
            for part, start, (run, _), length in zip(parts, starts, chosen, lengths, strict=True)
        ]
        return torch.stack(errors).mean(dim=0)

    def loss(self, errors: Tensor) -> Tensor:
        """Return the weighted sum of `errors` []."""
        weights = errors.new_tensor([self.phase.weights[name] for name in ERRORS])
        return (weights * errors).sum()
