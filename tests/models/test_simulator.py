"""One step: normalisation, integration, symmetries, and the cheating model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch
from gns_pl.models.config import OUTPUTS, SimulatorConfig
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import rollout, static_of
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory, ballistic_history
from tests.conftest import make_config, make_moving, make_simulator, make_start, make_static


class Cheat(Simulator):
    """A simulator whose network knows the truth: it returns the normalised target of the true next frame."""

    def __init__(self, config: SimulatorConfig, truth: Trajectory) -> None:
        super().__init__(config)
        self.truth = torch.from_numpy(truth.position)
        self.frame = 0

    def normalised_acceleration(self, history: torch.Tensor, static: SceneBatch, **_: object) -> torch.Tensor:
        self.frame += 1
        true_history = history.clone()
        for back in range(history.shape[1]):
            if self.frame - 1 - back >= 0:
                true_history[:, -1 - back] = self.truth[self.frame - 1 - back]
        return self.target(true_history, self.truth[self.frame], static)


def test_true_accelerations_reproduce_the_trajectory(drop: Scene) -> None:
    """Normalisation, pre-history, gravity and integration undo each other (the cheating-model test)."""
    truth = make_moving(drop, frames=25)
    cheat = Cheat(make_config(), truth)
    cheat.set_statistics(velocity=0.7, acceleration=5.5, material=torch.tensor([[0.5], [0.1]]))
    predicted = rollout(cheat, truth, 24)
    assert np.abs(predicted.position - truth.position).max() < 2e-5


def test_free_fall_is_exact_if_the_network_is_silent(drop: Scene) -> None:
    for output in OUTPUTS:
        simulator = make_simulator(output=output)
        last = simulator.network.decoder[-1]
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.zeros_(last.bias)
        if output != "acceleration":
            last.bias.data[3:] = 100.0  # gate wide open
        start = make_start(drop)
        predicted = rollout(simulator, start, 10)
        time = 0.01 * np.arange(11)[:, None, None]
        # semi-implicit Euler with constant g: x_n = x_0 + n v_0 dt + g dt² n (n + 1) / 2
        fall = np.array([0, 0, -9.81]) * 0.5 * time * (time + 0.01)
        expected = start.position + start.initial_velocity * time + fall
        np.testing.assert_allclose(predicted.position, expected, atol=5e-6)


@pytest.mark.parametrize("output", OUTPUTS)
def test_a_particle_without_contact_falls_freely_whatever_the_weights(output: str) -> None:
    simulator, static = make_simulator(output=output), make_static(3)
    end = torch.tensor([[0.5, 0.5, 0.5], [0.3, 0.3, 0.8], [0.3, 0.3, 0.05]])  # alone, alone, at the floor
    velocity = torch.tensor([[0.2, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    history = end[:, None] - 0.01 * velocity[:, None] * torch.arange(3, -1, -1.0)[:, None]
    moved = (simulator(history, static) - end) / 0.01 - velocity - 0.01 * static.gravity
    assert moved[:2].abs().max() < 1e-4 < moved[2].abs().max()


def test_closed_gate_brings_everything_to_rest(drop: Scene) -> None:
    simulator = make_simulator(output="gated")
    last = simulator.network.decoder[-1]
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    last.bias.data[3:] = -100.0
    predicted = rollout(simulator, make_start(drop), 5)
    np.testing.assert_allclose(predicted.position[1:], predicted.position[:1].repeat(5, axis=0), atol=1e-6)


@pytest.mark.parametrize("output", OUTPUTS)
def test_target_and_integration_are_inverse(output: str) -> None:
    simulator, static = make_simulator(output=output), make_static(20)
    history = torch.rand(20, 4, 3) * 0.01 + 0.2 + 0.6 * torch.rand(20, 1, 3)
    following = history[:, -1] + 0.01 * torch.randn(20, 3)
    target = simulator.target(history, following, static)
    torch.testing.assert_close(simulator.integrate(history, target, static), following, atol=1e-6, rtol=0)


def test_moving_scene_and_box_changes_nothing(drop: Scene) -> None:
    simulator, start = make_simulator(), make_start(drop)
    static = static_of(start)
    past = ballistic_history(start.position[0], start.initial_velocity, 0.01, 4)
    history = torch.from_numpy(past).transpose(0, 1).double()
    simulator = simulator.double()
    shift = torch.tensor([2.0, -1.0, 0.5], dtype=torch.float64)
    moved = dataclasses.replace(static, lower=static.lower + shift, upper=static.upper + shift)
    first = simulator(history, static)
    torch.testing.assert_close(simulator(history + shift, moved) - shift, first, atol=1e-6, rtol=0)


def test_a_batch_equals_its_scenes_alone() -> None:
    simulator = make_simulator()
    history = torch.rand(30, 4, 3) * 0.002 + torch.rand(30, 1, 3) * 0.4
    together = simulator(torch.cat([history, history + 0.1]), make_static(30, graphs=2))
    alone = torch.cat([simulator(history, make_static(30)), simulator(history + 0.1, make_static(30))])
    torch.testing.assert_close(together, alone, atol=1e-6, rtol=0)


def test_nothing_leaves_the_box() -> None:
    simulator, static = make_simulator(), make_static(20)
    history = 0.05 * torch.rand(20, 4, 3)
    following = simulator.integrate(history, 100 * torch.randn(20, 3), static)
    assert (following == 0).any()
    assert following.min() >= 0 and following.max() <= 1


def test_kinematic_particles_are_not_integrated() -> None:
    simulator = make_simulator(particle_types=(3, 6))
    static = make_static(10)
    static.particle_type[:4] = 3
    history = torch.rand(10, 4, 3)
    following = simulator(history, static)
    assert torch.equal(following[:4], history[:4, -1])
    assert not torch.equal(following[4:], history[4:, -1])


def test_gradients_against_finite_differences() -> None:
    simulator, static = make_simulator().double(), make_static(8)
    history = torch.rand(8, 1, 3).double() * 0.15 + torch.rand(8, 4, 3).double() * 1e-3
    history.requires_grad_()
    assert torch.autograd.gradcheck(lambda h: simulator(h, static), (history,), eps=1e-7, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latent_size": 0}, "latent_size"),
        ({"connectivity_radius": -1.0}, "connectivity_radius"),
        ({"output": "velocity"}, "output"),
        ({"latent": 3}, "unknown key latent"),
    ],
)
def test_config_refusals(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_config(**change)


def test_config_round_trip_and_missing_key() -> None:
    config = make_config()
    assert SimulatorConfig.from_dict(config.to_dict()) == config
    values = config.to_dict()
    del values["dt"]
    with pytest.raises(InputError, match="missing key dt"):
        SimulatorConfig.from_dict(values)


def test_statistics_must_be_usable() -> None:
    with pytest.raises(InputError, match="moving particles"):
        make_simulator().set_statistics(velocity=0.0, acceleration=1.0, material=torch.tensor([[0.5], [0.1]]))
