"""Corrected coarse runs with derivatives: their values are the run's, and the solver's step has a plain derivative.

The material point step itself is not differentiated. A velocity given now carries on and decays: with δx and δv what
positions and velocities change by, from one correction to the next

    δx ← δx + Δt δv,    δv ← (δv + δw) exp(−λ Δt),    λ = λ₀ − λ₁ u² / (u² + 3 s²)

where w is the correction, u a point's horizontal speed and s the corrector's velocity scale (a straight-through
derivative; Bengio, Léonard and Courville 2013). What slides fast on the floor keeps a velocity longest. λ₀ and λ₁ are
such that the response of fronts and centres of columns to a velocity given along the flow, in all, in the outermost
tenth or in the rest, is that of coarse runs to about a third (docs/reductions.md). The corrector itself is
differentiated, by its weights and by the places that it sees.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from gns_pl.graph import SceneBatch
from gns_pl.models.corrector import Corrector
from gns_pl.mpm.settings import stepped_run
from gns_pl.rollout import static_of
from gns_pl.scene import Scene
from gns_pl.solvers.correction import CoarseStart
from gns_pl.training.symmetry import Symmetry

DECAY = (9.3, 6.7)
"""Rates at which a velocity given is lost: of a slow point, and by how much less a fast one loses it [1/s]."""


def straight_run(corrector: Corrector, start: CoarseStart, num_steps: int, turn: Symmetry | None = None) -> Tensor:
    """Return the positions of every frame of a corrected run, with derivatives by the corrector's weights.

    Args:
        corrector: corrects; of the run it sees what `solvers.correction.corrected_frames` shows it.
        start: of the run.
        num_steps: frames to add.
        turn: symmetry of the box in which the corrector sees the run; None shows it as it is.

    Returns:
        [num_steps + 1, N, D] [m].

    Raises:
        SimulationError: the run became unstable.
    """
    interval, dtype, scenes = corrector.config.interval, corrector.velocity_scale.dtype, static_of(start.first)
    run = stepped_run(start.first.scene, start.mpm, start.points, interval)

    def places(position: NDArray[np.float64]) -> Tensor:
        return torch.from_numpy(position).to(dtype)

    now, before = places(run.position), places(run.position - run.velocity * interval)
    # Zeros, whose derivatives are those of positions and velocities; the first ones so that autograd follows.
    place_change, speed_change = torch.zeros_like(now, requires_grad=True), torch.zeros_like(now)
    frames = [now]
    for _ in range(num_steps):
        run.advance()
        place_change = place_change + interval * speed_change
        after = places(run.position) + place_change
        correction = cast(
            Tensor, checkpoint(_correction, corrector, before, now, after, scenes, start.unit, turn, use_reentrant=True)
        )
        run.add_velocity(correction.detach().numpy())
        square = ((after - now).detach()[:, :-1] / interval).square().sum(dim=1, keepdim=True)
        rate = DECAY[0] - DECAY[1] * square / (square + 3 * corrector.velocity_scale.square())
        speed_change = (speed_change + correction - correction.detach()) * torch.exp(-rate * interval)
        before, now = now, after
        frames.append(now)
    return torch.stack(frames)


def _correction(
    corrector: Corrector,
    before: Tensor,
    position: Tensor,
    predicted: Tensor,
    scenes: SceneBatch,
    unit: float,
    turn: Symmetry | None,
) -> Tensor:
    """Return what a corrector gives in a turned box, turned back [N, D] [m/s]."""
    if turn is None:
        return cast(Tensor, corrector(before, position, predicted, scenes, unit))
    places = turn.turned(torch.stack([before, position, predicted], dim=1), scenes.batch).unbind(dim=1)
    velocity = corrector(*places, turn.scenes(scenes), unit)
    return turn.undone(velocity[:, None], scenes.batch, vectors=True)[:, 0]


def mirrored(frames: Tensor, scene: Scene, mirrors: tuple[int, ...]) -> Tensor:
    """Return the frames of a whole scene from those of its half, in the order of `Reduction.lift` [T, M, D] [m].

    Args:
        frames: [T, N, D] [m].
        scene: the whole one.
        mirrors: `Reduction.mirrors`.
    """
    for axis in reversed(mirrors):
        sign, offset = torch.ones(scene.dim), torch.zeros(scene.dim)
        sign[axis], offset[axis] = -1.0, scene.lower[axis] + scene.upper[axis]
        frames = torch.cat([frames, sign * frames + offset], dim=1)
    return frames
