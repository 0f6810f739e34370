"""What is asked: which friction angle and which initial velocity left this deposit; a learned simulator answers.

The body, its place, the walls and the floor are known. The unknowns are θ = (tan φ, u) of all particles, u [m/s] along
x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.inverse.deposit import deposit_misfit, deposit_thickness
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import static_of
from gns_pl.rollout.gradient import differentiable_rollout
from gns_pl.trajectory import Trajectory

FRICTION = "tan_friction_angle"


@dataclass(frozen=True)
class Problem:
    """A deposit to be explained.

    Attributes:
        simulator: of two dimensions, with tan φ among its material features; its weights' precision is the rollout's.
        start: the scene filled, in one frame; its tan φ and its velocities along x are what is unknown.
        num_steps: of the simulator until the deposit is looked at.
        places: where the thickness was observed [P] [m].
        observed: the thickness there [P] [m].
        width: of the kernel with which it was smoothed [m].
        recompute: as in `differentiable_rollout`; of few particles every state of every step can be kept.

    Raises:
        InputError: a simulator that does not know tan φ, or another dimension than two.
    """

    simulator: Simulator
    start: Trajectory
    num_steps: int
    places: Tensor
    observed: Tensor
    width: float
    recompute: bool = False

    def __post_init__(self) -> None:
        config = self.simulator.config
        if FRICTION not in config.material_features:
            raise InputError(
                f"this simulator knows nothing of {FRICTION}; it was trained with {config.material_features}."
            )
        if config.dim != 2 or self.start.scene.dim != 2:
            raise InputError("a deposit is compared along one horizontal axis: simulator and scene in two dimensions.")

    def rollout(self, unknowns: Tensor, num_steps: int | None = None) -> Tensor:
        """Return the positions of every frame [T, S, N, 2] [m] for S sets of unknowns, stepped together.

        Args:
            unknowns: θ of every set [S, 2]; the positions have derivatives by them.
            num_steps: fewer or more than those of the problem.
        """
        kind, sets, start = self.simulator.velocity_scale.dtype, len(unknowns), self.start
        static = static_of(*[start] * sets, config=self.simulator.config).in_precision(kind)
        friction, along = unknowns.to(kind).repeat_interleave(start.num_particles, dim=0).unbind(dim=1)
        material = list(static.material.unbind(dim=1))
        material[start.material_features.index(FRICTION)] = friction
        velocity = torch.from_numpy(start.initial_velocity).to(kind).repeat(sets, 1)
        velocity = torch.cat([along[:, None], velocity[:, 1:]], dim=1)
        position = torch.from_numpy(start.position[0]).to(kind).repeat(sets, 1)
        static = replace(static, material=torch.stack(material, dim=1))
        steps = self.num_steps if num_steps is None else num_steps
        frames = differentiable_rollout(self.simulator, position, velocity, static, steps, recompute=self.recompute)
        return frames.view(len(frames), sets, start.num_particles, 2)

    def thickness(self, position: Tensor) -> Tensor:
        """Return the smoothed thickness of a frame where it was observed [P] [m].

        Args:
            position: [N, 2] [m].
        """
        scene, kind = self.start.scene, position.dtype
        volume = torch.from_numpy(self.start.volume()).to(kind)
        walls = (scene.lower[0], scene.upper[0])
        return deposit_thickness(position, volume, self.places.to(kind), self.width, walls)

    def misfits(self, unknowns: Tensor, num_steps: int | None = None) -> Tensor:
        """Return `deposit_misfit` of the last frame for every set [S]; arguments as those of `rollout`."""
        last = self.rollout(unknowns, num_steps)[-1].to(unknowns.dtype)
        observed = self.observed.to(unknowns.dtype)
        return torch.stack([deposit_misfit(self.thickness(positions), observed) for positions in last])


@dataclass
class ByGradient:
    """Misfit and its gradient by reverse mode through all steps: there and back once, whatever the number of unknowns.

    Attributes:
        problem: whose misfit.
        num_rollouts: made so far, each with its way back.
    """

    problem: Problem
    num_rollouts: int = 0

    def __call__(self, unknowns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return misfit and gradient [2] at θ."""
        point = torch.tensor(unknowns, dtype=torch.float64, requires_grad=True)
        (misfit,) = self.problem.misfits(point[None])
        (gradient,) = torch.autograd.grad(misfit, point)
        self.num_rollouts += 1
        return float(misfit.detach()), gradient.numpy()


@dataclass
class ByDifferences:
    """The same by central differences: 1 + 2 rollouts for every unknown, stepped together.

    Attributes:
        problem: whose misfit.
        steps: half the difference of each unknown [2].
        num_rollouts: made so far.
    """

    problem: Problem
    steps: Sequence[float]
    num_rollouts: int = 0

    def __call__(self, unknowns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return misfit and gradient [2] at θ."""
        shifts = np.diag(self.steps)
        points = np.stack([unknowns, *(unknowns + shifts), *(unknowns - shifts)])
        with torch.no_grad():
            misfits = self.problem.misfits(torch.from_numpy(points))
        here, ahead, behind = torch.split(misfits, [1, len(shifts), len(shifts)])
        self.num_rollouts += len(points)
        return float(here), ((ahead - behind) / (2 * torch.tensor(self.steps, dtype=here.dtype))).numpy()
