"""Derivatives of a rollout against finite differences of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gns_pl.metrics.measures import percentile_front
from gns_pl.rollout import rollout, static_of
from gns_pl.rollout.gradient import differentiable_front, differentiable_rollout
from gns_pl.scene import Scene
from tests.conftest import make_simulator, make_start

STEPS, SPACING = 8, 0.075


@pytest.fixture(params=[False, True])
def case(request: pytest.FixtureRequest, column: Scene) -> dict[str, object]:
    """A column in float64, thrown so that fronts move; with and without context."""
    simulator = make_simulator(output="gated", context=request.param, connectivity_radius=0.16).double()
    start = make_start(column, SPACING)
    static = static_of(start)
    static = replace(
        static,
        **{name: getattr(static, name).double() for name in ("material", "volume", "lower", "upper", "gravity")},
    )
    position = torch.from_numpy(start.position[0]).double()
    velocity = torch.randn(position.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return {"simulator": simulator, "static": static, "position": position, "velocity": velocity + 0.5}


def runout(case: dict[str, object], velocity: torch.Tensor, material: torch.Tensor) -> torch.Tensor:
    static = replace(case["static"], material=material)  # type: ignore[type-var]
    frames = differentiable_rollout(case["simulator"], case["position"], velocity, static, STEPS)  # type: ignore[arg-type]
    return differentiable_front(frames[-1][:, 0], static.volume, 90.0, SPACING)


def test_gradient_of_the_runout_is_its_finite_difference(case: dict[str, object]) -> None:
    velocity, material = case["velocity"], case["static"].material  # type: ignore[attr-defined]
    velocity, material = velocity.clone().requires_grad_(), material.clone().requires_grad_()
    runout(case, velocity, material).backward()
    direction = torch.randn(velocity.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    small = 1e-7
    with torch.no_grad():
        by_velocity = [runout(case, velocity + sign * small * direction, material) for sign in (1, -1)]
        by_friction = [runout(case, velocity, material + sign * small) for sign in (1, -1)]
    along = float((velocity.grad * direction).sum())
    assert abs(along) > 1e-4
    assert along == pytest.approx(float(by_velocity[0] - by_velocity[1]) / (2 * small), rel=1e-4)
    friction = float(material.grad.sum())
    assert abs(friction) > 1e-7
    assert friction == pytest.approx(float(by_friction[0] - by_friction[1]) / (2 * small), rel=1e-3, abs=1e-8)


def test_frames_are_those_of_the_rollout(column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column)
    position, velocity = torch.from_numpy(start.position[0]), torch.from_numpy(start.initial_velocity)
    with torch.no_grad():
        frames = differentiable_rollout(simulator, position, velocity, static_of(start), 5)
    np.testing.assert_allclose(frames.numpy(), rollout(simulator, start, 5).position, atol=1e-6)


def test_weights_get_gradients_too(column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column, 0.1)
    position, velocity = torch.from_numpy(start.position[0]), torch.from_numpy(start.initial_velocity)
    differentiable_rollout(simulator, position, velocity, static_of(start), 3)[-1].sum().backward()
    assert all(parameter.grad is not None for parameter in simulator.parameters())


@pytest.mark.parametrize("percent", [50.0, 90.0, 99.0])
def test_the_front_is_the_one_of_the_evaluation(percent: float) -> None:
    generator = np.random.default_rng(0)
    coordinate, mass = generator.uniform(0, 1, 300), generator.uniform(1, 2, 300)
    front = differentiable_front(torch.from_numpy(coordinate), torch.from_numpy(mass), percent, 0.05)
    assert float(front) == pytest.approx(percentile_front(coordinate[None], mass, [percent], 0.05)[0, 0], abs=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_front_in_a_gap_moves_with_one_particle(dtype: torch.dtype) -> None:
    place = torch.cat([torch.linspace(0, 1, 99), torch.tensor([3.0])]).to(dtype)
    for mass in np.linspace(0.1, 2.3, 61):  # with some of them rounding leaves the front between the widths of both
        coordinate = place.clone().requires_grad_()
        front = differentiable_front(coordinate, torch.full((100,), mass, dtype=dtype), 99.0, 0.05)
        front.backward()
        assert 1.0 < float(front.detach()) < 3.0
        assert sorted(coordinate.grad.tolist()) == [0.0] * 99 + [1.0]
