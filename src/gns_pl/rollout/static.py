"""What does not change while scenes are stepped, from the trajectories that start them."""

from __future__ import annotations

import torch

from gns_pl.data.solids import surfaces_of
from gns_pl.graph import SceneBatch, Surfaces
from gns_pl.models.config import SimulatorConfig
from gns_pl.trajectory import Trajectory


def static_of(*trajectories: Trajectory, config: SimulatorConfig | None = None) -> SceneBatch:
    """Return the time-independent tensors of trajectories, one scene each.

    Args:
        trajectories: whose scenes, types and materials are taken.
        config: of the simulator that steps them; None for one that knows the box alone.
    """
    scenes = [trajectory.scene for trajectory in trajectories]
    seen = config.spacing if config is not None and config.sees_surfaces else None
    numbers = torch.tensor([trajectory.num_particles for trajectory in trajectories])
    return SceneBatch(
        particle_type=torch.cat([torch.from_numpy(trajectory.particle_type) for trajectory in trajectories]),
        material=torch.cat([torch.from_numpy(trajectory.material) for trajectory in trajectories]),
        volume=torch.cat([torch.from_numpy(trajectory.volume()) for trajectory in trajectories]),
        lower=torch.tensor([scene.lower for scene in scenes], dtype=torch.float32),
        upper=torch.tensor([scene.upper for scene in scenes], dtype=torch.float32),
        gravity=torch.tensor([scene.gravity for scene in scenes], dtype=torch.float32),
        batch=torch.arange(len(scenes)).repeat_interleave(numbers),
        surfaces=None if seen is None else Surfaces.joined([surfaces_of(scene, seen) for scene in scenes]),
    )
