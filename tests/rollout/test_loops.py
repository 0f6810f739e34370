"""Steps in compiled loops, as a CPU makes them without gradients, against the same steps of torch's operations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gns_pl.graph import SceneBatch, radius_graph
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import Run, rollout
from gns_pl.rollout.engine import history_of, static_of
from gns_pl.rollout.stabilise import FoundPairs, StableStepper, stabilise
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.trajectory import Trajectory
from tests.conftest import CallStepper, make_simulator, make_start, make_static

STABLE: dict[str, Any] = {"sleep": 0.1, "min_distance": 0.5, "energy_limiter": True}
LOOPS = ("graph.features", "models.simulator", "rollout.rest", "rollout.stabilise")


def without_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let torch's operations make everything."""
    for module in LOOPS:
        monkeypatch.setattr(f"gns_pl.{module}.compiles", lambda *tensors, backward=False: False)
    monkeypatch.setattr("gns_pl.nn.encode_process_decode.can_pack", lambda network: False)


def thrown(start: Trajectory) -> Trajectory:
    """The same with velocities, so that something moves whatever the weights are."""
    draw = np.random.default_rng(0).normal(0.4, 0.4, start.initial_velocity.shape)
    return replace(start, initial_velocity=draw.astype(np.float32))


@pytest.fixture(params=[2, 3])
def case(request: pytest.FixtureRequest, column: Scene, drop: Scene) -> tuple[Simulator, list[Scene]]:
    """A simulator and a column and a drop, in plane strain or in space."""
    settings: dict[str, Any] = {"output": "gated", "context": True, "input_sequence_length": 2}
    if request.param == 3:
        return make_simulator(**settings), [column, drop]
    walls = {face: Wall("friction", 0.385) for face in FACES[2]}
    sand = column.materials["sand"]
    flat = column_collapse(
        domain=(1.5, 0.7), length=0.3, height=0.5, gravity=9.81, duration=0.5, material=sand, walls=walls
    )
    return make_simulator(dim=2, **settings), [flat]


def test_a_rollout_of_twenty_steps(case: tuple[Simulator, list[Scene]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding is all that differs: 1e-5 m, where particles are 0.05 m apart."""
    simulator, scenes = case
    starts = [thrown(make_start(scene)) for scene in scenes]
    got = [rollout(stabilise(simulator, **STABLE), start, 20).position for start in starts]
    without_loops(monkeypatch)
    simulator.network._packed_key = ()
    for start, position in zip(starts, got, strict=True):
        expected = rollout(stabilise(simulator, **STABLE), start, 20).position
        assert np.abs(expected[-1] - expected[0]).max() > 0.01
        np.testing.assert_allclose(position, expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("output", ["acceleration", "gated"])
def test_a_step_of_several_scenes(column: Scene, drop: Scene, output: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With particles out of the box, on a wall, alone, and one that a script holds."""
    simulator = make_simulator(output=output, context=True, input_sequence_length=2)
    starts = [make_start(column), make_start(drop)]
    scenes = static_of(*starts)
    scenes.particle_type[5] = 3
    history = torch.cat([history_of(Run(start, 1), simulator.config) for start in starts])
    history[3] = torch.tensor([0.0, 0.0, -0.01])
    history[-1, 1] = torch.tensor([0.9, 0.9, 0.9])
    history[-2, 1, 0] += 5.0  # crosses the box in a step
    with torch.inference_mode():
        got = simulator(history, scenes)
        without_loops(monkeypatch)
        simulator.network._packed_key = ()
        torch.testing.assert_close(got, simulator(history, scenes), atol=1e-6, rtol=0, equal_nan=True)


@pytest.mark.parametrize("spread", [0.004, 0.03, 1.0])
def test_particles_move_apart_alike(spread: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In clumps that need all sweeps, and further than the pairs that were found last; some in one place."""
    simulator = make_simulator()
    draw = torch.Generator().manual_seed(0)
    position = 0.5 + spread * (torch.rand(80, 3, generator=draw) - 0.5)
    position[1] = position[0]
    stepper = StableStepper(CallStepper(simulator, lambda history, scenes: position.clone()), 0.5, False)
    with torch.inference_mode():
        got = stepper(position[:, None].expand(-1, 4, -1), make_static(80))
        without_loops(monkeypatch)
        expected = stepper(position[:, None].expand(-1, 4, -1), make_static(80))
    torch.testing.assert_close(got, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("output", ["acceleration", "gated"])
@pytest.mark.parametrize("context", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_step_has_the_derivatives_of_torchs_operations(output: str, context: bool, dim: int) -> None:
    """Of single precision in loops by history, material and weights, against those of double precision, which has none.

    With particles out of the box, alone, on top of each other, and one that a script holds; two boxes.
    """
    settings: dict[str, Any] = {"material_features": ("tan_friction_angle",), "particle_types": (3, 6)}
    simulator = make_simulator(output=output, context=context, dim=dim, **settings)
    draw, number = torch.Generator().manual_seed(0), 120
    scenes = make_static(number // 2, graphs=2, gravity=(*[0.0] * (dim - 1), -9.81))
    scenes = replace(scenes, material=torch.rand(number, 1, generator=draw))
    scenes.particle_type[5] = 3
    scenes.upper[1] *= 0.7
    position = torch.rand(number, dim, generator=draw) * torch.linspace(0.2, 0.4, dim)
    position[3, 0], position[4], position[9] = -0.01, 0.6, position[8] + 1e-3
    shifts = 0.01 * torch.randn(number, simulator.history_length, dim, generator=draw).cumsum(dim=1)
    history = position[:, None] + shifts - shifts[:, -1:]
    weight = torch.randn(number, dim, generator=draw)

    def gradients(dtype: torch.dtype) -> list[torch.Tensor]:
        material = scenes.material.to(dtype, copy=True).requires_grad_()
        past = history.to(dtype, copy=True).requires_grad_()
        static = replace(scenes.in_precision(dtype), material=material)
        moved = simulator.to(dtype)(past, static)
        found = torch.autograd.grad((weight.to(dtype) * moved).sum(), [past, material, *simulator.parameters()])
        return [value.double() for value in found]

    for mine, exact in zip(gradients(torch.float32), gradients(torch.float64), strict=True):
        assert bool(exact.abs().max() > 0)
        torch.testing.assert_close(mine, exact, rtol=0, atol=1e-5 * float(exact.abs().max()))


def test_compiled_loops_make_the_step_with_derivatives_too(column: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*arguments: object, **settings: object) -> None:
        raise AssertionError("torch's operations")

    monkeypatch.setattr("gns_pl.graph.features.context_fields", forbidden)
    monkeypatch.setattr("gns_pl.nn.interaction_network.InteractionNetwork.forward", forbidden)
    simulator, start = make_simulator(output="gated", context=True), make_start(column)
    history = history_of(Run(start, 1), simulator.config).requires_grad_()
    simulator(history, static_of(start)).sum().backward()
    assert history.grad is not None and bool(torch.isfinite(history.grad).all())
    assert all(weight.grad is not None for weight in simulator.network.parameters())


@pytest.mark.parametrize(("move", "searches"), [(0.0, 0), (0.02, 0), (0.2, 1)])
def test_pairs_that_the_step_found_are_enough_where_nothing_moved_far(
    move: float, searches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Particles that fall together by as much as one likes, and each by `move` besides; compared with a new search."""
    simulator, draw = make_simulator(), torch.Generator().manual_seed(0)
    before = 0.3 + 0.2 * torch.rand(200, 3, generator=draw)
    after = before + move * (torch.rand(200, 3, generator=draw) - 0.5) + torch.tensor([0.0, 0.0, -0.2])
    found, scenes = FoundPairs(radius_graph), make_static(200)
    radius = simulator.config.connectivity_radius

    def step(history: torch.Tensor, scenes: SceneBatch) -> torch.Tensor:
        found(before, radius)
        return after

    history = before[:, None].expand(-1, 4, -1)
    expected = StableStepper(CallStepper(simulator, step), 0.5, False)(history, scenes)
    assert float((expected - after).abs().max()) > 1e-3
    counted = list[int]()

    def search(*arguments: Any, **settings: Any) -> torch.Tensor:
        counted.append(1)
        return radius_graph(*arguments, **settings)

    monkeypatch.setattr("gns_pl.rollout.stabilise.radius_graph", search)
    got = StableStepper(CallStepper(simulator, step), 0.5, False, found)(history, scenes)
    torch.testing.assert_close(got, expected, atol=1e-6, rtol=0)
    assert len(counted) == searches
