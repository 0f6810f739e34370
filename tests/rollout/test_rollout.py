from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.rollout import Run, rollout, unroll
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
    with pytest.raises(InputError, match="scene 'cube_drop' has obstacles, which a simulator of bare boxes does not"):
        rollout(make_simulator(), make_start(drop.replace(obstacles=(slope,))), 1)


def test_scenes_in_one_batch_move_as_each_alone(drop: Scene, column: Scene) -> None:
    simulator = make_simulator(output="gated", context=True)
    starts = [make_start(drop), make_start(column)]
    together: list[list[np.ndarray]] = [[], []]
    with torch.inference_mode():
        for parts in unroll(simulator, [Run(starts[0], 7), Run(starts[1], 4)]):
            for number, position in parts.items():
                together[number].append(position.numpy())
    assert [len(frames) for frames in together] == [7, 4]
    for start, frames in zip(starts, together, strict=True):
        alone = rollout(simulator, start, len(frames)).position[1:]
        np.testing.assert_allclose(np.stack(frames), alone, atol=2e-6)


def test_one_scene_of_a_batch_explodes_and_the_others_go_on(drop: Scene) -> None:
    simulator, start = make_simulator(), make_start(drop)
    wild = replace(start, initial_velocity=np.full_like(start.initial_velocity, 1e30))
    with torch.inference_mode():
        seen = [sorted(parts) for parts in unroll(simulator, [Run(wild, 5), Run(start, 5)])]
    assert seen == [[1]] * 5


def test_going_on_from_the_last_frames_is_exact(drop: Scene) -> None:
    simulator, start = make_simulator(), make_start(drop)
    whole = rollout(simulator, start, 9).position
    for made in (1, 2, 5):  # fewer and more than the history needs
        run = Run(start, 9 - made, past=whole[max(0, made - 6) : made + 1], made=made)
        with torch.inference_mode():
            rest = [parts[0].numpy() for parts in unroll(simulator, [run])]
        np.testing.assert_array_equal(np.stack(rest), whole[made + 1 :])


def test_given_frames_are_kept_and_gone_on_from(drop: Scene) -> None:
    """A rollout from its own first six frames is the same rollout, scripted particles too."""
    moving = make_moving(drop, frames=13)
    kinds = moving.particle_type.copy()
    kinds[:7] = 3
    simulator, start = make_simulator(particle_types=(3, 6)), replace(moving, particle_type=kinds)
    calls: list[tuple[int, int]] = []
    whole = rollout(simulator, start, 12)
    script = start.position.copy()
    script[:6] = whole.position[:6]
    again = rollout(
        simulator, replace(start, position=script), 7, given=6, on_step=lambda *numbers: calls.append(numbers)
    )
    np.testing.assert_array_equal(again.position, whole.position)
    np.testing.assert_array_equal(again.position[:, :7], start.position[:, :7])
    assert calls == [(number, 7) for number in range(1, 8)] and "at_rest_from" not in again.provenance
    other = rollout(simulator, start, 7, given=6)  # from frames that a rollout would not have come to
    np.testing.assert_array_equal(other.position[:6], start.position[:6])
    assert not np.allclose(other.position[6], whole.position[6])
