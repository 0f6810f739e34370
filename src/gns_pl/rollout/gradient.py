"""Derivatives of a whole rollout: its steps with few frames remembered, each made a second time on the way back.

Backpropagation through T steps would keep every edge state of every step. Here only the positions are kept, and each
step is computed a second time when its gradient is due (Griewank and Walther 2000), so memory grows with T · N and not
with T · E · L. What is differentiated is the simulator with its neighbour lists held: edges that appear or vanish are
jumps, which have no derivative.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from gns_pl.graph import SceneBatch
from gns_pl.models.simulator import Simulator


def differentiable_rollout(
    simulator: Simulator,
    position: Tensor,
    velocity: Tensor,
    scenes: SceneBatch,
    num_steps: int,
    *,
    recompute: bool = True,
) -> Tensor:
    """Return the positions of every frame, with derivatives by whatever of the input requires them.

    Weights, positions, velocities and `scenes.material` can; e.g. tan φ is a material feature.

    Args:
        simulator: makes one step; its weights' precision is the rollout's, whatever that of the input is.
        position: first frame [N, D] [m].
        velocity: of the first frame [N, D] [m/s].
        scenes: those that are stepped.
        num_steps: frames to add.
        recompute: make every step a second time on the way back; else all its states are kept, which takes less time
            and T · E · L numbers of memory.

    Returns:
        [num_steps + 1, N, D] [m].
    """
    config, dtype = simulator.config, simulator.velocity_scale.dtype
    position, velocity, scenes = position.to(dtype), velocity.to(dtype), scenes.in_precision(dtype)
    before = torch.arange(config.input_sequence_length - 1, -1, -1, dtype=position.dtype, device=position.device)
    history = position[:, None] - before[:, None] * (velocity * config.dt)[:, None]
    frames = [position]
    for _ in range(num_steps):
        # `scenes` is not an argument for autograd to see, but its tensors are recorded when the step is made again.
        if recompute:
            frame = cast(Tensor, checkpoint(simulator, history, scenes, use_reentrant=False))
        else:
            frame = simulator(history, scenes)
        frames.append(frame)
        history = torch.cat([history[:, 1:], frame[:, None]], dim=1)
    return torch.stack(frames)


def differentiable_front(coordinate: Tensor, mass: Tensor, percent: float, width: float) -> Tensor:
    """Return the coordinate behind which q % of the mass lies, as `metrics.measures.percentile_front` does.

    The front z solves F(z) = Σ m_i clip((z − x_i) / w + 1/2, 0, 1) = q/100 Σ m_i. Its derivative is the implicit
    function's: ∂z/∂x_i = m_i / Σ m_j over the particles whose width w the front cuts.

    Args:
        coordinate: distance from the wall [N] [m].
        mass: [N] [kg].
        percent: q, below 100.
        width: particle spacing w [m].

    Returns:
        [] [m].
    """
    with torch.no_grad():
        goal = percent / 100 * mass.sum()
        low, high = coordinate.min() - width / 2, coordinate.max() + width / 2
        for _ in range(64):  # halvings: down to the last bit of float64
            middle = (low + high) / 2
            enough = (mass * ((middle - coordinate) / width + 0.5).clamp(0, 1)).sum() >= goal
            low, high = torch.where(enough, low, middle), torch.where(enough, middle, high)
        share = mass * ((high - coordinate).abs() < width / 2)
        share = share / share.sum()
    return high + (share * (coordinate - coordinate.detach())).sum()
