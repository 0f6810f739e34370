"""What has to hold for every registered model, and for one whose network is somebody else's."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gns_pl.models.registry import MODELS, build_simulator, kind_of, register_model
from gns_pl.models.simulator import Simulator
from gns_pl.nn import NETWORKS, register_network
from tests.conftest import make_config, make_static
from tests.extend.page import blocks

FRAMES = {"input_sequence_length": 6, "num_types": 9, "type_size": 4, "boundary_clip": 1.0, "edge_update": "residual"}
NUMBER = 40


def build(kind: str, **changes: object) -> Simulator:
    """A model of a kind with its settings; statistics as of slow sand."""
    torch.manual_seed(0)
    settings = make_config().to_dict() | (FRAMES if kind == "frames" else {}) | changes
    simulator = build_simulator({"kind": kind, **settings}).eval()
    moments = {"velocity": {"mean": [0.0] * 3, "std": [0.5] * 3}, "acceleration": {"mean": [0.0] * 3, "std": [4.0] * 3}}
    simulator.fit_statistics(moments, gravity=9.81, noise_std=0.0, material=torch.tensor([[0.5], [0.1]]))
    return simulator


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder that holds the network and the model of the page that says how to add one."""
    (tmp_path / "own_models.py").write_text("\n".join([*blocks("A network"), *blocks("A model")]))
    monkeypatch.chdir(tmp_path)
    return tmp_path


Make = Callable[[], Simulator]
CASES: dict[str, Make] = {
    "simulator": lambda: build("simulator", context=True, output="gated"),
    "frames": lambda: build("frames"),
    "own network": lambda: build("simulator", network={"_target_": "own_models.Averages", "share": 0.25}),
    "own model": lambda: build("own_models.Damped"),
}


def make_history(length: int) -> torch.Tensor:
    """A clump that moves and shakes [N, H, D] [m]."""
    generator = torch.Generator().manual_seed(1)
    start = 0.35 + 0.3 * torch.rand(NUMBER, 1, 3, generator=generator)
    return start + 0.002 * torch.randn(NUMBER, length, 3, generator=generator).cumsum(dim=1)


@pytest.mark.parametrize("case", CASES)
class TestEveryModel:
    """The truths of a step."""

    @pytest.fixture
    def simulator(self, case: str, own_folder: Path) -> Simulator:
        return CASES[case]()

    @pytest.fixture
    def history(self, simulator: Simulator) -> torch.Tensor:
        return make_history(simulator.history_length)

    def test_the_order_of_particles_does_not_matter(self, simulator: Simulator, history: torch.Tensor) -> None:
        order, static = torch.randperm(NUMBER), make_static(NUMBER)
        torch.testing.assert_close(
            simulator(history[order], static), simulator(history, static)[order], atol=1e-6, rtol=0
        )

    def test_a_scene_elsewhere_moves_alike(self, simulator: Simulator, history: torch.Tensor) -> None:
        static, shift = make_static(NUMBER), torch.tensor([0.5, -0.25, 1.0])
        moved = dataclasses.replace(static, lower=static.lower + shift, upper=static.upper + shift)
        torch.testing.assert_close(
            simulator(history + shift, moved) - shift, simulator(history, static), atol=2e-5, rtol=0
        )

    def test_scenes_of_a_batch_move_as_each_alone(self, simulator: Simulator, history: torch.Tensor) -> None:
        both = torch.cat([history, history.flip(0)])
        alone = [simulator(each, make_static(NUMBER)) for each in (history, history.flip(0))]
        torch.testing.assert_close(simulator(both, make_static(NUMBER, graphs=2)), torch.cat(alone), atol=1e-6, rtol=0)

    def test_the_target_of_a_step_is_what_integrates_to_it(self, simulator: Simulator, history: torch.Tensor) -> None:
        static = make_static(NUMBER)
        normalised = torch.randn(NUMBER, 3, generator=torch.Generator().manual_seed(2))
        position = simulator.integrate(history, 0.1 * normalised, static)
        torch.testing.assert_close(simulator.target(history, position, static), 0.1 * normalised, atol=2e-3, rtol=0)

    def test_the_gradient_is_that_of_differences(self, simulator: Simulator, history: torch.Tensor) -> None:
        simulator, history = simulator.double(), history.double()
        static = _double(make_static(NUMBER))
        direction = torch.randn(history.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        history.requires_grad_()
        (gradient,) = torch.autograd.grad(simulator(history, static).square().sum(), history)
        small = 1e-7
        with torch.no_grad():
            ends = [simulator(history + sign * small * direction, static).square().sum() for sign in (1, -1)]
        assert float((gradient * direction).sum()) == pytest.approx(float(ends[0] - ends[1]) / (2 * small), rel=1e-4)

    def test_a_checkpoint_builds_it_again(self, simulator: Simulator, history: torch.Tensor, tmp_path: Path) -> None:
        save_checkpoint(tmp_path / "model.ckpt", Checkpoint(simulator, {}, {}))
        again = load_checkpoint(tmp_path / "model.ckpt").simulator
        assert type(again).__qualname__ == type(simulator).__qualname__ and again.config == simulator.config
        assert torch.equal(again(history, make_static(NUMBER)), simulator(history, make_static(NUMBER)))


def _double(static: SceneBatch) -> SceneBatch:
    floats = {each.name: getattr(static, each.name) for each in dataclasses.fields(static)}
    changed = {name: v.double() for name, v in floats.items() if isinstance(v, torch.Tensor) and v.is_floating_point()}
    return dataclasses.replace(static, **changed)


def test_what_is_registered_goes_by_its_name(own_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns_pl.models.registry.MODELS", dict(MODELS))
    monkeypatch.setattr("gns_pl.nn.network.NETWORKS", dict(NETWORKS))
    model = type(build("own_models.Damped"))
    network = type(build("simulator", network="own_models.Averages").network)
    assert kind_of(build("own_models.Damped")) == "own_models.Damped"
    register_model("damped", model)
    register_network("averages", network)
    simulator = build("damped", network="averages")
    assert type(simulator) is model and type(simulator.network) is network and kind_of(simulator) == "damped"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"network": "attention"},
            r"model\.network must be one of encode_process_decode, or MODULE\.CLASS",
        ),
        (
            {"network": "own_models.Nothing"},
            "model.network=own_models.Nothing: .* has no attribute 'Nothing'",
        ),
        ({"network": "nowhere.Network"}, "model.network=nowhere.Network: No module named 'nowhere'"),
        ({"network": "own_models.Damped"}, "is no subclass of gns_pl.nn.network.Network"),
        ({"network": {"_target_": "own_models.Averages", "heads": 3}}, "unexpected keyword argument 'heads'"),
        ({"kind": "os.path"}, "model.kind=os.path: is no subclass of gns_pl.models.simulator.Simulator"),
    ],
)
def test_what_is_no_model_is_told(changes: dict[str, object], message: str, own_folder: Path) -> None:
    with pytest.raises(InputError, match=message):
        build(**{"kind": "simulator", **changes})  # type: ignore[arg-type]
