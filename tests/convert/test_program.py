"""Exported programs make the simulator's steps, of other numbers of particles and edges than they were traced with."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from gns_pl.convert.program import METADATA, PARTS, export_program, trace
from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, edge_features, radius_graph
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.models.simulator import Simulator
from tests.commands.in_process import call
from tests.conftest import make_static
from tests.models.test_every_model import build

PAGE = Path(__file__).parents[2] / "docs" / "export.md"
NAMES = {
    "step": ("history", "edge_index", "particle_type", "material", "volume", "lower", "upper", "gravity"),
    "network": ("node", "edge", "edge_index"),
}
NETWORK = '''
from torch import nn
from gns_pl.nn import Network


class Plain(Network):
    """A layer for nodes, and the sum of edges; `len` and an option as in anybody's network."""

    def __init__(self, *, node_width, edge_width, output_width, jumps=False, **_):
        super().__init__()
        self.node, self.edge = nn.Linear(node_width, output_width), nn.Linear(edge_width, output_width)
        self.jumps = jumps

    def forward(self, node, edge, edge_index):
        if self.jumps and float(edge.sum()) > 0:
            return self.node(node)
        message = self.edge(edge)
        return self.node(node) + message.new_zeros(len(node), message.shape[1]).index_add(0, edge_index[1], message)
'''
CASES: dict[str, dict[str, object]] = {
    "context": {"dim": 2, "context": True, "output": "gated", "num_message_passing_steps": 1},
    "frames": {"kind": "frames", "num_message_passing_steps": 1},
    "own network": {"network": "plain_network.Plain", "material_features": (), "particle_types": (5, 6)},
}


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "plain_network.py").write_text(NETWORK)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def make(case: str) -> Simulator:
    return build(**{"kind": "simulator", **CASES[case]})  # type: ignore[arg-type]


def read_program(path: Path) -> tuple[Callable[..., Tensor], dict[str, object]]:
    """A file as a function of tensors, and its metadata."""
    if path.suffix == ".onnx":
        import onnxruntime

        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        metadata = json.loads(session.get_modelmeta().custom_metadata_map[METADATA])
        taken = {each.name for each in session.get_inputs()}

        def run(*arguments: Tensor) -> Tensor:
            named = zip(NAMES[metadata["part"]], arguments, strict=True)
            [result] = session.run(None, {name: value.numpy() for name, value in named if name in taken})
            return torch.from_numpy(result)

        return run, metadata
    extra = {METADATA: ""}
    program = torch.export.load(path, extra_files=extra)
    return torch.no_grad()(program.module()), json.loads(extra[METADATA])


def clump(simulator: Simulator, number: int, size: float) -> tuple[Tensor, ...]:
    """Arguments of a step: particles in the middle of a box of another size than one, on the move."""
    generator, dim = torch.Generator().manual_seed(number), simulator.config.dim
    history = size * (0.35 + 0.3 * torch.rand(number, 1, dim, generator=generator))
    shape = (number, simulator.history_length, dim)
    history = history + 0.002 * torch.randn(shape, generator=generator).cumsum(1)
    edge_index = radius_graph(history[:, -1], simulator.config.connectivity_radius)
    static = make_static(number)
    material = static.material[:, : len(simulator.config.material_features)]
    box = torch.zeros(dim), torch.full((dim,), size), torch.tensor([0.5, 0.0, -9.81])[-dim:]
    return history, edge_index, static.particle_type, material, static.volume, *box


def own_step(simulator: Simulator, arguments: tuple[Tensor, ...]) -> Tensor:
    history, _, particle_type, material, volume, *box = arguments
    static = SceneBatch(particle_type, material, volume, *(each[None] for each in box), torch.zeros_like(particle_type))
    with torch.no_grad():
        return simulator(history, static)


@pytest.mark.parametrize("case", CASES)
def test_a_step_is_that_of_the_simulator(case: str, own_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Half the time is the tracing, which is the same for both kinds of files.
    monkeypatch.setattr("gns_pl.convert.program.trace", functools.cache(trace))
    simulator = make(case)
    for suffix in (".pt2", ".onnx"):
        program, metadata = read_program(export_program(simulator, own_folder / f"step{suffix}"))
        assert metadata["part"] == "step" and metadata["connectivity_radius"] == simulator.config.connectivity_radius
        for number, size in ((80, 1.0), (50, 1.7), (1, 1.0)):
            arguments = clump(simulator, number, size)
            expected = own_step(simulator, arguments)
            assert (expected - arguments[0][:, -1]).abs().max() > 1e-3
            torch.testing.assert_close(program(*arguments), expected, atol=1e-6, rtol=0)


def test_a_network_is_that_of_the_simulator(tmp_path: Path) -> None:
    simulator = make("context")
    program, metadata = read_program(export_program(simulator, tmp_path / "net.onnx", part="network"))
    assert metadata["part"] == "network"
    arguments = clump(simulator, 60, 1.0)
    with torch.no_grad():
        node, edge_index = simulator.features(arguments[0], make_static(60, gravity=(0.0, -9.81)))
        edge = edge_features(arguments[0][:, -1], edge_index, simulator.config.connectivity_radius)
        expected = simulator.network(node, edge, edge_index)
    assert edge_index.shape[1] > 60
    torch.testing.assert_close(program(node, edge, edge_index), expected, atol=1e-6, rtol=1e-6)


def test_what_cannot_be_exported_is_told_and_leaves_nothing(own_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = make("own network")
    (own_folder / "there.pt2").touch()
    for target, part, message in (
        ("step.pt", "step", "must end in .pt2 for torch.export, or in .onnx"),
        ("there.pt2", "step", "exists already"),
        ("new.pt2", "gradient", "part must be one of step, network"),
    ):
        with pytest.raises(InputError, match=message):
            export_program(simulator, own_folder / target, part=part)
    simulator.network.jumps = True  # type: ignore[assignment]
    with pytest.raises(InputError, match=r"new.pt2: this model cannot be exported \(.*[dD]ata-dependent.*\)\."):
        export_program(simulator, "new.pt2", part=PARTS[1])
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"new.onnx needs onnx and onnxscript: pip install 'gns_pl\[export\]'"):
        export_program(simulator, "new.onnx")
    assert sorted(path.name for path in own_folder.glob("*.*")) == ["plain_network.py", "there.pt2"]


def test_the_command_takes_a_name_and_tells_correctors(tmp_path: Path) -> None:
    result = call(tmp_path, "convert.py", "source=collapse_plane", "target=out/net.pt2", "part=network")
    assert (result.returncode, result.stdout) == (0, "Made: out/net.pt2\n"), result.stderr
    program, _ = read_program(tmp_path / "out" / "net.pt2")
    network = load_checkpoint("collapse_plane").simulator.network
    arguments = torch.rand(9, 13), torch.rand(4, 3), torch.tensor([[0, 1, 2, 8], [1, 0, 8, 2]])
    torch.testing.assert_close(program(*arguments), network(*arguments).detach(), atol=1e-6, rtol=1e-6)
    told = call(tmp_path, "convert.py", "source=corrected_plane", "target=net.onnx")
    assert told.returncode == 2 and "corrected_plane: corrects MPM" in told.stderr
    told = call(tmp_path, "convert.py", "source=nothing.ckpt", "target=net.onnx")
    assert told.returncode == 2 and "nothing.ckpt: there is no such checkpoint" in told.stderr


@pytest.mark.slow
def test_the_page_runs_a_block_as_the_simulator_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its Python exports a shipped model and steps by ONNX Runtime alone; the same steps follow here without it."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, PAGE.name, "exec"), names)
    frames, first = torch.from_numpy(names["frames"]), torch.from_numpy(names["first"])  # type: ignore[arg-type]
    simulator = load_checkpoint("column-fast-plane").simulator
    number, history = len(first), first
    static = make_static(number, gravity=(0.0, -9.81))
    settings = {"volume": simulator.config.spacing**2, "material": names["tan_friction"]}
    changed = {name: torch.full_like(getattr(static, name), value) for name, value in settings.items()}
    static = dataclasses.replace(static, upper=torch.tensor([[2.0, 0.8]]), **changed)
    with torch.no_grad():
        for position in frames:
            history = torch.cat([history[:, 1:], simulator(history, static)[:, None]], dim=1)
            torch.testing.assert_close(position, history[:, -1], atol=1e-3, rtol=0)
    assert len(frames) == 50 and float(frames[-1, :, 0].max() - first[:, -1, 0].max()) > 0.05
