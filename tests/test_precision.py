"""Numbers of double precision, and torch's own default set to it, change no value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gns_pl.data.statistics import RunningStatistics
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.models.corrector import Corrector, CorrectorConfig
from gns_pl.mpm import MPMConfig, simulate
from gns_pl.rollout import rollout, static_of
from gns_pl.rollout.gradient import differentiable_rollout
from gns_pl.scene import Material, Scene
from gns_pl.trajectory import Trajectory
from tests.conftest import MPM, make_simulator, make_start


@pytest.fixture
def double() -> Iterator[Any]:
    """Sets torch's default to double precision when called; it is put back at the end."""
    yield lambda: torch.set_default_dtype(torch.float64)
    torch.set_default_dtype(torch.float32)


def gradient(start: Trajectory, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the last frame, and the derivative of its mean height by every particle's tan φ."""
    simulator, static = make_simulator(context=True), static_of(start)
    material = static.material.to(dtype).requires_grad_()
    position, velocity = (torch.from_numpy(each).to(dtype) for each in (start.position[0], start.initial_velocity))
    last = differentiable_rollout(simulator, position, velocity, replace(static, material=material), 3)[-1]
    (found,) = torch.autograd.grad(last[:, -1].mean(), material)
    return last.detach(), found


def test_a_rollout_is_the_same(drop: Scene, double: Any) -> None:
    """Of weights made under either default, and of what a file holds."""
    start = make_start(drop)
    expected = rollout(make_simulator(context=True), start, 5).position
    shipped = load_checkpoint("collapse").simulator
    weights = {name: value.clone() for name, value in shipped.state_dict().items()}
    double()
    simulator = make_simulator(context=True)
    simulator.set_statistics(velocity=0.8, acceleration=6.0, material=torch.tensor([[0.5], [0.1]]))
    position = rollout(simulator, start, 5).position
    assert position.dtype == np.float32
    np.testing.assert_array_equal(position, expected)
    again = load_checkpoint("collapse").simulator.state_dict()
    assert all(torch.equal(again[name], value) and again[name].dtype == value.dtype for name, value in weights.items())
    assert torch.get_default_dtype() == torch.float64


def test_a_gradient_is_the_same(drop: Scene, double: Any) -> None:
    start = make_start(drop)
    last, derivative = gradient(start, torch.float32)
    double()
    other, of_double = gradient(start, torch.float64)
    assert torch.equal(other, last)
    torch.testing.assert_close(of_double.float(), derivative, rtol=1e-6, atol=0)
    assert derivative.abs().max() > 0


def test_arrays_of_double_precision_become_those_of_files(drop: Scene) -> None:
    start = make_start(drop)
    lists = {name: getattr(start, name).tolist() for name in ("particle_type", "mass")}
    doubles = {name: getattr(start, name).astype(np.float64) for name in ("position", "material")}
    velocity = torch.from_numpy(start.initial_velocity).double()
    other = replace(start, **lists, **doubles, initial_velocity=velocity)
    assert other.position.dtype == np.float64  # which measures may need
    for name in (*lists, *doubles, "initial_velocity"):
        if name != "position":
            assert getattr(other, name).dtype == getattr(start, name).dtype
        np.testing.assert_array_equal(getattr(other, name), getattr(start, name))
    simulator = make_simulator()
    np.testing.assert_array_equal(rollout(simulator, other, 3).position, rollout(simulator, start, 3).position)


def scalars(kind: Any) -> Material:
    values = {"density": 1800.0, "youngs_modulus": 2e6, "poisson_ratio": 0.3, "friction_angle_deg": 30.0}
    return Material(**{name: kind(value) for name, value in values.items()}, cohesion=kind(100.0))


def test_scenes_of_double_scalars_run_as_those_of_plain_ones(drop: Scene, double: Any) -> None:
    """The material point method included, whose points and nodes are NumPy's."""
    scene = replace(drop, duration=0.02)
    config = MPMConfig(cell_size=1 / 8, **MPM)
    expected = simulate(scene, config, frame_interval=0.01).position
    double()
    for kind in (np.float64, torch.tensor):
        (body,) = scene.bodies
        body = replace(body, position=tuple(kind(value) for value in body.position), velocity=kind([0.5, -0.25, 1.0]))
        other = replace(scene, materials={"sand": scalars(kind)}, bodies=(body,), gravity=kind(list(scene.gravity)))
        assert other.materials == scene.materials
        position = simulate(other, config, frame_interval=kind(0.01)).position
        np.testing.assert_array_equal(position, expected)


def test_statistics_and_corrections_are_the_same(drop: Scene, double: Any) -> None:
    values = np.random.default_rng(0).normal(size=(50, 3))
    moments = []
    for dtype in (np.float32, np.float64):
        seen = RunningStatistics(3)
        seen.update(values.astype(np.float32).astype(dtype))
        moments.append(seen.to_dict())
        double()
    assert moments[0]["mean"] == pytest.approx(moments[1]["mean"], rel=1e-6)
    assert moments[0]["std"] == pytest.approx(moments[1]["std"], rel=1e-6)

    config = CorrectorConfig(
        dim=3, interval=0.02, spacing=0.05, connectivity_radius=0.11, mpm={}, latent_size=8, num_mlp_layers=1,
        num_message_passing_steps=1, velocity_threshold=0.1,
    )  # fmt: skip
    start = make_start(drop)
    position = torch.from_numpy(start.position[0])
    places = [position - 0.01, position, position + 0.01]
    corrections = []
    for default, dtype in ((torch.float32, torch.float32), (torch.float64, torch.float64)):
        torch.set_default_dtype(default)
        torch.manual_seed(0)
        corrector = Corrector(config)
        corrections.append(corrector(*(each.to(dtype) for each in places), static_of(start).in_precision(dtype)))
    assert torch.equal(*corrections) and corrections[0].dtype == torch.float32
