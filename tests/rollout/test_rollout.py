from __future__ import annotations

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.rollout import rollout
from gns_pl.scene import Plane, Scene, Wall
from tests.conftest import make_moving, make_simulator, make_start


def test_rollout_is_repeated_stepping(drop: Scene) -> None:
    simulator, start = make_simulator(), make_start(drop)
    predicted = rollout(simulator, start, 6)
    assert predicted.position.shape == (7, start.num_particles, 3)
    assert predicted.dt == simulator.config.dt and predicted.scene == drop
    continued = rollout(simulator, start, 3)
    np.testing.assert_array_equal(continued.position, predicted.position[:4])


def test_history_is_the_last_frames(drop: Scene) -> None:
    """A simulator that returns the mean of its history sees exactly the last H positions."""
    simulator, start = make_simulator(), make_start(drop)
    seen = []

    def watch(module: torch.nn.Module, arguments: tuple[torch.Tensor, ...]) -> None:
        seen.append(arguments[0].numpy().copy())

    simulator.register_forward_pre_hook(watch)
    predicted = rollout(simulator, start, 6)
    np.testing.assert_array_equal(seen[5], predicted.position[2:6].transpose(1, 0, 2))
    first = start.position[0] - 0.03 * start.initial_velocity
    np.testing.assert_allclose(seen[0][:, 0], first, atol=1e-6)


def test_an_explosion_ends_the_rollout_and_is_told(drop: Scene) -> None:
    simulator = make_simulator()
    simulator.acceleration_scale.fill_(1e38)
    predicted = rollout(simulator, make_start(drop), 50)
    assert predicted.num_frames < 51
    assert np.isfinite(predicted.position).all()
    assert 0 < predicted.provenance["failed_at"] <= 0.5


def test_kinematic_particles_follow_their_script(drop: Scene) -> None:
    simulator = make_simulator(particle_types=(3, 6))
    truth = make_moving(drop, frames=8)
    truth.particle_type[:5] = 3
    predicted = rollout(simulator, truth, 7)
    np.testing.assert_array_equal(predicted.position[:, :5], truth.position[:, :5])
    assert np.abs(predicted.position[:, 5:] - truth.position[:, 5:]).max() > 0
    with pytest.raises(InputError, match="script"):
        rollout(simulator, truth, 8)


def test_a_start_that_does_not_fit(drop: Scene) -> None:
    with pytest.raises(InputError, match="particle types"):
        rollout(make_simulator(particle_types=(3,)), make_start(drop), 1)
    with pytest.raises(InputError, match="material features"):
        rollout(make_simulator(material_features=("cohesion",)), make_start(drop), 1)
    with pytest.raises(InputError, match="dimensions"):
        rollout(make_simulator(dim=2), make_start(drop), 1)


def test_a_scene_with_obstacles_is_refused(drop: Scene) -> None:
    slope = Plane((0, 0, 0.1), (1, 0, 3), Wall("slip"))
    with pytest.raises(InputError, match="scene 'cube_drop' has obstacles, and a learned simulator knows no obstacles"):
        rollout(make_simulator(), make_start(drop.replace(obstacles=(slope,))), 1)
