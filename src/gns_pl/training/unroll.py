"""Several steps in a row during training, so that a network meets the states that its own errors lead to."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from gns_pl.graph import SceneBatch
from gns_pl.models.simulator import Simulator


def unrolled_loss(
    simulator: Simulator,
    history: Tensor,
    goal: Tensor,
    future: Tensor,
    scenes: SceneBatch,
    *,
    restore: float,
    loss: Callable[[Tensor, Tensor], Tensor],
) -> Tensor:
    """Return the loss of U steps in a row, each from the positions the one before led to, gradients through all.

    With e the position error after a step, the target of the next one leaves (1 − κ) e of it, as `Perturbation` does
    with the noise n of the first: κ = 0 asks for the right velocity, κ = 1 for the right position. In units of the
    normalised acceleration the residual of step k is (e_{k+1} − (1 − κ) e_k) / (Δt² scale), so that slow common
    errors, which a single step hides in its noise, count as often as steps carry them on.

    Args:
        simulator: makes one step.
        history: perturbed positions [N, H, D] [m].
        goal: what the first step should lead to [N, D] [m].
        future: true positions of the U next frames [N, U, D] [m].
        scenes: those that are stepped.
        restore: κ.
        loss: of predicted and target normalised accelerations [N, D].

    Returns:
        Mean over the U steps [].
    """
    steps = future.shape[1]
    total = history.new_zeros(())
    for step in range(steps):
        normalised = simulator.normalised_acceleration(history, scenes)
        target = simulator.target(history, goal, scenes)
        total = total + loss(normalised, target)
        if step + 1 < steps:
            position = simulator.integrate(history, normalised, scenes)
            position = torch.where(scenes.moved[:, None], position, future[:, step])
            goal = future[:, step + 1] + (1 - restore) * (position - future[:, step])
            history = torch.cat([history[:, 1:], position[:, None]], dim=1)
    return total / steps
