"""Several steps in a row against the plain loop of single steps, and the gradient that goes through them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from gns_pl.training.unroll import unrolled_loss
from tests.conftest import make_simulator, make_static

NUMBER, LENGTH, STEPS = 30, 4, 3


def make_case() -> tuple[Tensor, Tensor, Tensor]:
    """History, what the first step should lead to, and the true future of a clump that drifts and shakes."""
    generator = torch.Generator().manual_seed(0)
    start = 0.4 + 0.2 * torch.rand(NUMBER, 1, 3, generator=generator)
    path = start + 0.002 * torch.randn(NUMBER, LENGTH + STEPS, 3, generator=generator).cumsum(dim=1)
    history, future = path[:, :LENGTH].double(), path[:, LENGTH:].double()
    return history, future[:, 0] + 0.001, future


@pytest.mark.parametrize("restore", [0.0, 0.3, 1.0])
def test_it_is_the_residual_of_every_step(restore: float) -> None:
    simulator, static = make_simulator().double(), make_static(NUMBER)
    history, goal, future = make_case()
    got = unrolled_loss(simulator, history, goal, future, static, restore=restore, loss=mse_loss)
    scale = simulator.acceleration_scale * simulator.config.dt**2
    error, expected = goal - future[:, 0], []
    with torch.no_grad():
        for step in range(STEPS):
            # What the first goal leaves of the noise is told, not computed from κ.
            left = error if step == 0 else (1 - restore) * error
            following = simulator(history, static)
            error = following - future[:, step]
            expected.append((((error - left) / scale) ** 2).mean())
            history = torch.cat([history[:, 1:], following[:, None]], dim=1)
    torch.testing.assert_close(got.detach(), torch.stack(expected).mean(), rtol=1e-9, atol=0)


def test_one_step_is_the_plain_loss() -> None:
    simulator, static = make_simulator(), make_static(NUMBER)
    history, goal, future = (value.float() for value in make_case())
    got = unrolled_loss(simulator, history, goal, future[:, :1], static, restore=0.2, loss=mse_loss)
    plain = mse_loss(simulator.normalised_acceleration(history, static), simulator.target(history, goal, static))
    assert torch.equal(got, plain)


def test_gradients_go_through_all_steps() -> None:
    """By differences of the loss along a random direction of all weights, in float64."""
    simulator, static = make_simulator().double(), make_static(NUMBER)
    case = make_case()

    def loss() -> Tensor:
        return unrolled_loss(simulator, *case, static, restore=0.2, loss=mse_loss)

    parameters = list(simulator.parameters())
    gradients = torch.autograd.grad(loss(), parameters)
    generator = torch.Generator().manual_seed(1)
    directions = [torch.randn(p.shape, generator=generator, dtype=p.dtype) for p in parameters]
    along = sum(float((g * d).sum()) for g, d in zip(gradients, directions, strict=True))
    small, values = 1e-6, []
    with torch.no_grad():
        for sign in (1, -2):
            for parameter, direction in zip(parameters, directions, strict=True):
                parameter += sign * small * direction
            values.append(float(loss()))
    assert along == pytest.approx((values[0] - values[1]) / (2 * small), rel=1e-4)
