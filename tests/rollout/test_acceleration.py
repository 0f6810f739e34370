"""Every acceleration against the plain loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

import gns_pl.rollout.acceleration
from gns_pl.errors import InputError
from gns_pl.graph import NeighbourList, radius_graph
from gns_pl.rollout import Run, rollout, static_of
from gns_pl.rollout.acceleration import InPrecision, Padded, accelerate
from gns_pl.rollout.engine import history_of
from gns_pl.rollout.stepper import SimulatorStepper
from gns_pl.scene import Scene
from tests.conftest import make_simulator, make_start


@pytest.mark.parametrize("skin", [0.1, 0.5])
def test_a_skin_changes_nothing(skin: float, column: Scene) -> None:
    simulator, start = make_simulator(output="gated", context=True), make_start(column)
    plain = rollout(simulator, start, 12).position
    np.testing.assert_array_equal(rollout(accelerate(simulator, skin=skin), start, 12).position, plain)


def test_padding_changes_nothing(column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column)
    plain = rollout(simulator, start, 5).position
    padded = SimulatorStepper(simulator, radius_graph, Padded(simulator.network, 1000))
    np.testing.assert_allclose(rollout(padded, start, 5).position, plain, atol=1e-6)


@pytest.mark.parametrize(("precision", "tolerance"), [("tf32", 1e-6), ("bfloat16", 2e-3)])
def test_less_precise_products(precision: str, tolerance: float, column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column)
    plain = rollout(simulator, start, 5).position
    fast = rollout(accelerate(simulator, precision=precision), start, 5).position
    assert fast.dtype == np.float32
    np.testing.assert_allclose(fast, plain, atol=tolerance)
    assert torch.get_float32_matmul_precision() == "highest"


def test_the_simulator_stays_as_it_is() -> None:
    simulator = make_simulator()
    network = simulator.network
    fast = accelerate(simulator, skin=0.2, precision="bfloat16")
    assert simulator.network is network
    assert isinstance(fast, SimulatorStepper) and isinstance(fast.search, NeighbourList)
    assert isinstance(fast.network, InPrecision) and fast.network.network is network


@pytest.mark.slow
def test_compiled_networks_agree(column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column)
    plain = rollout(simulator, start, 5).position
    np.testing.assert_allclose(rollout(accelerate(simulator, compiled=True), start, 5).position, plain, atol=1e-5)


ON_GPU: list[tuple[dict[str, Any], float]] = [
    ({"skin": 0.3}, 1e-5),
    ({"skin": 0.3, "compiled": True}, 1e-5),
    ({"skin": 0.3, "precision": "bfloat16"}, 2e-3),
    ({"captured": True}, 1e-5),
    ({"captured": True, "precision": "tf32"}, 2e-4),
    ({"captured": True, "precision": "bfloat16"}, 2e-3),
]


@pytest.mark.gpu
@pytest.mark.parametrize(("settings", "tolerance"), ON_GPU)
def test_on_a_gpu_as_on_the_cpu(settings: dict[str, Any], tolerance: float, column: Scene) -> None:
    simulator, start = make_simulator(output="gated", context=True, latent_size=32), make_start(column)
    plain = rollout(simulator, start, 5).position
    fast = rollout(accelerate(simulator.cuda(), **settings), start, 5).position
    np.testing.assert_allclose(fast, plain, atol=tolerance)


@pytest.mark.gpu
def test_a_captured_step_makes_room_for_more_edges(column: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gns_pl.rollout.acceleration, "EDGE_BUDGET", 1)
    simulator, start = make_simulator(latent_size=32).cuda(), make_start(column)
    captured = accelerate(simulator, captured=True)
    history, static = history_of(Run(start, 1), simulator.config).cuda(), static_of(start).to("cuda")
    with torch.inference_mode():
        for squeeze in (1.0, 0.6, 1.0):
            np.testing.assert_allclose(
                captured(history * squeeze, static).cpu(), simulator(history * squeeze, static).cpu(), atol=1e-6
            )


@pytest.mark.gpu
def test_captured_steps_stay_apart(column: Scene) -> None:
    simulator, start = make_simulator(latent_size=32).cuda(), make_start(column)
    fast = [accelerate(simulator, captured=True, precision=each) for each in ("float32", "bfloat16", "tf32")]
    history, static = history_of(Run(start, 1), simulator.config).cuda(), static_of(start).to("cuda")
    with torch.inference_mode():
        first = [each(history, static) for each in fast]
        kept = [torch.randn(1000, 1000, device="cuda") for _ in range(50)]  # takes what has been freed
        for _ in range(5):
            for one, expected in zip(fast, first, strict=True):
                assert torch.equal(one(history, static), expected)
    assert kept


def test_capturing_needs_a_gpu() -> None:
    with pytest.raises(InputError, match="needs a GPU"):
        accelerate(make_simulator(), captured=True)


@pytest.mark.parametrize("settings", [{"skin": -0.1}, {"precision": "float16"}, {"captured": True, "skin": 0.1}])
def test_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="acceleration"):
        accelerate(make_simulator(), **settings)
