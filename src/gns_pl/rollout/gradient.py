"""Derivatives of a whole rollout and of what is measured on it.

What is differentiated is the simulator with its neighbour lists held: edges that appear or vanish are jumps, which have
no derivative. Front, volume map and distances are those of `metrics`, with derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import torch
from torch import Tensor

from gns_pl.graph import SceneBatch
from gns_pl.metrics.maps import map_cells
from gns_pl.metrics.release import is_column
from gns_pl.models.simulator import Simulator
from gns_pl.rollout.recompute import all_frames, recomputed_frames
from gns_pl.rollout.stabilise import stabilise
from gns_pl.scene import Scene


def differentiable_rollout(
    simulator: Simulator,
    position: Tensor,
    velocity: Tensor,
    scenes: SceneBatch,
    num_steps: int,
    *,
    recompute: bool = True,
    stabilised: Mapping[str, Any] | None = None,
) -> Tensor:
    """Return the positions of every frame, with derivatives by whatever of the input requires them.

    Weights, positions, velocities and `scenes.material` can; e.g. tan φ is a material feature. A frame that is not
    finite is the last one.

    Args:
        simulator: makes one step; its weights' precision is the rollout's, whatever that of the input is.
        position: first frame [N, D] [m].
        velocity: of the first frame [N, D] [m/s].
        scenes: those that are stepped.
        num_steps: frames to add.
        recompute: make every step a second time on the way back (`rollout.recompute`); else all its states are kept,
            T · E · L numbers.
        stabilised: arguments of `rollout.stabilise.stabilise`; None leaves the steps as they are.

    Returns:
        [num_steps + 1, N, D] [m], or fewer frames.
    """
    config, dtype = simulator.config, simulator.velocity_scale.dtype
    stepper = stabilise(simulator, **(stabilised or {}))
    position, velocity, scenes = position.to(dtype), velocity.to(dtype), scenes.in_precision(dtype)
    before = torch.arange(config.input_sequence_length - 1, -1, -1, dtype=position.dtype, device=position.device)
    history = position[:, None] - before[:, None] * (velocity * config.dt)[:, None]
    missing = (len(position), stepper.history_length - history.shape[1], config.dim)
    history = torch.cat([history.new_full(missing, torch.nan), history], dim=1)
    if num_steps < 1:
        return position[None]
    if recompute:
        frames = recomputed_frames(stepper, list(simulator.parameters()), history, scenes, num_steps)
    else:
        frames = all_frames(lambda positions: stepper(positions, scenes), history, num_steps)
    return torch.cat([position[None], frames])


def differentiable_front(coordinate: Tensor, mass: Tensor, percent: float, width: float) -> Tensor:
    """Return the coordinate behind which q % of the mass lies, as `metrics.measures.percentile_front` does.

    The front z solves F(z) = Σ m_i clip((z − x_i) / w + 1/2, 0, 1) = q/100 Σ m_i. Its derivative is the implicit
    function's: ∂z/∂x_i = m_i / Σ m_j over the particles whose width w the front cuts. Where it stands in a gap, as it
    does where the foremost of 100 equal particles is far ahead, that is the nearest one.

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
        away = (high - coordinate).abs()
        share = mass * torch.where(away.min() < width / 2, away < width / 2, away <= away.min())
        share = share / share.sum()
    return high + (share * (coordinate - coordinate.detach())).sum()


def differentiable_distance(position: Tensor, scene: Scene) -> Tensor:
    """Return what the front of a scene is measured on [N] [m], as `metrics.release.release_distance` does.

    Args:
        position: [N, D] [m].
        scene: its bodies, where they were released.
    """
    if is_column(scene):
        return position[:, 0] - scene.lower[0]
    distances = []
    for body in scene.bodies:
        low, high = position.new_tensor(body.position[:-1]), position.new_tensor(body.upper[:-1])
        beyond = torch.maximum(low - position[:, :-1], position[:, :-1] - high)
        outside = beyond.clamp_min(0).norm(dim=1)
        distances.append(torch.where(outside > 0, outside, beyond.amax(dim=1)))
    return torch.stack(distances).amin(dim=0)


def differentiable_volume_map(position: Tensor, volume: Tensor, scene: Scene, cell: float) -> Tensor:
    """Return the volume at every node of a horizontal grid over the box, as `metrics.maps.volume_map` does.

    Args:
        position: [N, D] [m].
        volume: of each particle [N] [m^D].
        scene: for the box.
        cell: wanted distance of nodes [m].

    Returns:
        [X + 1, Y + 1], or [X + 1] in two dimensions [m^D].
    """
    cells = map_cells(scene, cell).tolist()
    lower, upper = position.new_tensor(scene.lower[:-1]), position.new_tensor(scene.upper[:-1])
    place = ((position[:, :-1] - lower) / (upper - lower)).clamp(0, 1) * position.new_tensor(cells)
    node = torch.minimum(place.detach().long(), torch.tensor(cells, device=place.device) - 1)
    share, nodes = place - node, [number + 1 for number in cells]
    total = volume.new_zeros(nodes).flatten()
    for corner in product((0, 1), repeat=scene.dim - 1):
        index, weight = torch.zeros_like(node[:, 0]), volume
        for axis, side in enumerate(corner):
            index = index * nodes[axis] + node[:, axis] + side
            weight = weight * (share[:, axis] if side else 1 - share[:, axis])
        total = total.index_add(0, index, weight)
    return total.view(nodes)
