"""A rollout whose steps are made a second time on the way back, against one that keeps all states."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from gns_pl.rollout import static_of
from gns_pl.rollout.gradient import differentiable_rollout
from gns_pl.rollout.rest import REST_STEPS, SleepingStepper
from gns_pl.scene import Scene
from tests.conftest import make_simulator, make_start

STEPS = 6
STABLE: dict[str, Any] = {"sleep": 1.2, "min_distance": 0.8, "energy_limiter": True}
"""Of the particles below some sleep from the fourth step on, and all in the last."""


def derivatives(scene: Scene, dtype: torch.dtype, stabilised: dict[str, Any], **settings: Any) -> list[Tensor]:
    """Frames, and the gradient of what weighs all positions of all of them by whatever can have one."""
    simulator = make_simulator(output="gated", context=True).to(dtype)
    start = make_start(scene, 0.075)
    static = static_of(start).in_precision(dtype)
    draw = torch.Generator().manual_seed(3)
    position = torch.from_numpy(start.position[0]).to(dtype).requires_grad_()
    velocity = (0.4 * torch.randn(position.shape, generator=draw) + 0.2).to(dtype).requires_grad_()
    material = static.material.clone().requires_grad_()
    static = replace(static, material=material)
    frames = differentiable_rollout(simulator, position, velocity, static, STEPS, stabilised=stabilised, **settings)
    weight = torch.randn(frames.shape, generator=draw).to(dtype)
    inputs = [position, velocity, material, *simulator.parameters()]
    return [frames.detach(), *torch.autograd.grad((weight * frames).sum(), inputs)]


@pytest.mark.parametrize("stabilised", [{}, STABLE])
def test_it_has_the_gradients_of_one_that_keeps_all(column: Scene, stabilised: dict[str, Any]) -> None:
    expected = derivatives(column, torch.float64, stabilised, recompute=False)
    for one, two in zip(derivatives(column, torch.float64, stabilised), expected, strict=True):
        assert bool(two.abs().max() > 0)
        torch.testing.assert_close(one, two, rtol=1e-9, atol=1e-11 * float(two.abs().max()))


def test_the_way_there_in_compiled_loops_changes_no_more_than_rounding(column: Scene) -> None:
    """In single precision: of the largest entry of each gradient."""
    expected = derivatives(column, torch.float32, {}, recompute=False)
    for one, two in zip(derivatives(column, torch.float32, {}), expected, strict=True):
        torch.testing.assert_close(one, two, rtol=0, atol=1e-4 * float(two.abs().max()))


def test_where_all_sleep_the_network_is_left_out(column: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Positions, and their derivatives, go through such a step as they are."""
    evaluated, evaluate = list[int](), SleepingStepper._evaluate

    def counted(self: SleepingStepper, *arguments: Tensor) -> Tensor:
        evaluated.append(len(arguments[0]))
        return evaluate(self, *arguments)

    monkeypatch.setattr(SleepingStepper, "_evaluate", counted)
    simulator, start = make_simulator(), make_start(column, 0.1)
    position = torch.from_numpy(start.position[0]).requires_grad_()
    frames = differentiable_rollout(
        simulator, position, torch.zeros_like(position), static_of(start), 9, stabilised={"sleep": 1e6}
    )
    unknown = REST_STEPS - 1
    assert len(evaluated) == unknown > 0
    assert torch.equal(frames[unknown], frames[-1])
    frames[-1].sum().backward()
    assert len(evaluated) == 2 * unknown
    assert position.grad is not None and bool(torch.isfinite(position.grad).all())


def test_weights_that_are_held_get_no_gradient(column: Scene) -> None:
    simulator, start = make_simulator(), make_start(column, 0.1)
    held, *others = simulator.parameters()
    held.requires_grad_(False)
    position = torch.from_numpy(start.position[0])
    frames = differentiable_rollout(simulator, position, torch.zeros_like(position), static_of(start), 2)
    frames.sum().backward()
    assert held.grad is None and all(weight.grad is not None for weight in others)


def test_the_last_frame_is_one_that_is_not_finite(column: Scene) -> None:
    simulator, start = make_simulator(), make_start(column, 0.1)
    with torch.no_grad():
        for weight in simulator.parameters():
            weight.fill_(torch.inf)
    position = torch.from_numpy(start.position[0])
    for recompute in (False, True):
        frames = differentiable_rollout(
            simulator, position, torch.zeros_like(position), static_of(start), 4, recompute=recompute
        )
        assert len(frames) == 2 and frames.requires_grad
