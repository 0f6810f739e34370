"""Exported weights in the program of geoelements/gns: its network and normalisation written anew, in plain torch.

Everything that the program knows comes from metadata.json, from the constants in it, and from its option `noise_std`.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gns_pl.convert.weights_export import export_weights
from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch
from gns_pl.io import manifest_sha256, read_manifest, read_trajectory
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gns_pl.models.geoelements import FrameConfig, FrameSimulator
from tests.convert.test_own_sets import DIFFERENT, a_flight, a_scene, metadata_of, write_ours
from tests.convert.test_weights import imported, random_weights, saved
from tests.convert.test_weights import metadata_of as weights_metadata

NOISE = 6.7e-4


def their_mlp(width: int, hidden: int, out: int, layers: int) -> nn.Sequential:
    sizes = [width, *[hidden] * layers, out]
    parts: OrderedDict[str, nn.Module] = OrderedDict()
    for place in range(layers + 1):
        parts[f"NN-{place}"] = nn.Linear(sizes[place], sizes[place + 1])
        parts[f"Act-{place}"] = nn.ReLU() if place < layers else nn.Identity()
    return nn.Sequential(parts)


def normed(width: int, latent: int, layers: int) -> nn.Sequential:
    return nn.Sequential(their_mlp(width, latent, latent, layers), nn.LayerNorm(latent))


class Coder(nn.Module):
    """A place for node_fn and edge_fn."""

    def __init__(self, **functions: nn.Module) -> None:
        super().__init__()
        for name, function in functions.items():
            setattr(self, name, function)


class Processor(nn.Module):
    def __init__(self, latent: int, steps: int, layers: int) -> None:
        super().__init__()
        self.gnn_stacks = nn.ModuleList(
            Coder(node_fn=normed(2 * latent, latent, layers), edge_fn=normed(3 * latent, latent, layers))
            for _ in range(steps)
        )


class Core(nn.Module):
    def __init__(self, node: int, edge: int, out: int, latent: int, steps: int, layers: int) -> None:
        super().__init__()
        self._encoder = Coder(node_fn=normed(node, latent, layers), edge_fn=normed(edge, latent, layers))
        self._processor = Processor(latent, steps, layers)
        self._decoder = Coder(node_fn=their_mlp(latent, latent, out, layers))

    def forward(self, node: Tensor, edge: Tensor, receiver: Tensor, sender: Tensor) -> Tensor:
        node, edge = self._encoder.node_fn(node), self._encoder.edge_fn(edge)
        for layer in self._processor.gnn_stacks:
            message = layer.edge_fn(torch.cat([node[receiver], node[sender], edge], dim=1))
            summed = torch.zeros_like(node).index_add(0, receiver, message)
            node = node + layer.node_fn(torch.cat([summed, node], dim=1))
            edge = edge + message
        return self._decoder.node_fn(node)


class TheirSimulator(nn.Module):
    """What their program makes of a metadata.json."""

    def __init__(self, metadata: dict[str, Any], *, noise_std: float, latent: int = 128, steps: int = 10) -> None:
        super().__init__()
        dim = metadata["dim"]
        node, edge = (37 if dim == 3 else 30), dim + 1
        if "nnode_in" in metadata and "nedge_in" in metadata:
            node, edge = metadata["nnode_in"], metadata["nedge_in"]
        self._particle_type_embedding = nn.Embedding(9, 16)
        self._encode_process_decode = Core(node, edge, dim, latent, steps, 2)
        self.boundaries = torch.tensor(np.array(metadata["bounds"]), dtype=torch.float32)
        self.radius, self.clip = metadata["default_connectivity_radius"], metadata.get("boundary_augment", 1.0)
        self.mean = {key: torch.FloatTensor(metadata[f"{key}_mean"]) for key in ("vel", "acc")}
        self.std = {
            key: torch.sqrt(torch.FloatTensor(metadata[f"{key}_std"]) ** 2 + noise_std**2) for key in ("vel", "acc")
        }

    def forward(self, history: Tensor, types: Tensor, material: Tensor | None) -> Tensor:
        position = history[:, -1]
        velocity = (history[:, 1:] - history[:, :-1] - self.mean["vel"]) / self.std["vel"]
        walls = torch.cat([position - self.boundaries[:, 0], self.boundaries[:, 1] - position], dim=1) / self.radius
        node = [velocity.flatten(1), walls.clamp(-self.clip, self.clip), self._particle_type_embedding(types)]
        node += [] if material is None else [material[:, None]]
        difference = position[:, None] - position[None]
        receiver, sender = torch.nonzero(difference.norm(dim=2) < self.radius, as_tuple=True)
        relative = (position[sender] - position[receiver]) / self.radius
        edge = torch.cat([relative, relative.norm(dim=1, keepdim=True)], dim=1)
        output = self._encode_process_decode(torch.cat(node, dim=1), edge, receiver, sender)
        acceleration = output * self.std["acc"] + self.mean["acc"]
        return position + (position - history[:, -2]) + acceleration


def trained(folder: Path, path: Path, *, latent: int = 16, steps: int = 2, **provenance: Any) -> FrameSimulator:
    """A checkpoint as a training with model=geoelements on a set of ours leaves it, with random weights."""
    torch.manual_seed(1)
    manifest = read_manifest(folder)
    config = FrameConfig(
        dim=manifest.dim, dt=manifest.dt, spacing=manifest.spacing, particle_types=(6,),
        material_features=manifest.material_features, connectivity_radius=0.23, input_sequence_length=6,
        latent_size=latent, num_mlp_layers=2, num_message_passing_steps=steps, output="acceleration", context=False,
        neighbours="auto",
    )  # fmt: skip
    simulator = FrameSimulator(config).eval()
    simulator.fit_statistics(manifest.statistics, gravity=0.0, noise_std=NOISE, material=torch.empty(2, 0))
    told = {"config": {"training": {"noise_std": NOISE, "stride": 1}}, "manifest_sha256": manifest_sha256(folder)}
    data = {**manifest.spec, "imported": {}, "root": str(folder)}
    del data["families"]
    save_checkpoint(path, Checkpoint(simulator, data, {**told, **provenance}))
    return simulator


def a_set(folder: Path, dim: int, *, material: bool) -> Path:
    flights = [a_flight(a_scene(dim), frames) for frames in (12, 9)]
    if not material:
        flights = [replace(each, material=each.material[:, :0], material_features=()) for each in flights]
    return write_ours(folder, {"train": flights[:1], "test": flights[1:]})


@pytest.mark.parametrize(
    ("dim", "material", "latent", "steps"), [(2, False, 16, 2), (3, False, 16, 2), (3, True, 128, 10)]
)
def test_their_program_loads_and_steps_alike(
    tmp_path: Path, dim: int, material: bool, latent: int, steps: int, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = a_set(tmp_path / "a", dim, material=material)
    ours = trained(folder, tmp_path / "a.ckpt", latent=latent, steps=steps)
    path = export_weights(tmp_path / "a.ckpt", tmp_path / "there/model-0.pt")
    metadata = metadata_of(path.parent)
    there = TheirSimulator(metadata, noise_std=metadata["noise_std"], latent=latent, steps=steps).eval()
    there.load_state_dict(torch.load(path, weights_only=True), strict=True)
    truth = read_trajectory(folder / "trajectory_0001.h5")
    generator = torch.Generator().manual_seed(2)
    history = torch.from_numpy(truth.position[:6].transpose(1, 0, 2).copy())
    history = history + (1e-3 * torch.randn(history.shape, generator=generator)).cumsum(dim=1)
    static = SceneBatch(
        particle_type=torch.from_numpy(truth.particle_type),
        material=torch.from_numpy(truth.material),
        volume=torch.from_numpy(truth.volume()),
        lower=torch.tensor([truth.scene.lower], dtype=torch.float32),
        upper=torch.tensor([truth.scene.upper], dtype=torch.float32),
        gravity=torch.tensor([truth.scene.gravity], dtype=torch.float32),
        batch=torch.zeros(len(history), dtype=torch.int64),
    )
    with torch.no_grad():
        made = there(history, static.particle_type, static.material[:, 0] if material else None)
        torch.testing.assert_close(made, ours(history, static), atol=1e-6, rtol=0)
    still = 2 * history[:, -1] - history[:, -2]
    assert (made - still).abs().max() > 1e-4, "the network does something"
    assert metadata["bounds"] == [[0.0, 1.0]] * dim and metadata["sequence_length"] == 9 and metadata["dt"] == 0.01
    assert (metadata["nnode_in"], metadata["nedge_in"]) == ({2: 30, 3: 37}[dim] + material, dim + 1)
    told = capsys.readouterr().out
    assert "put" in told and ("latent_size 16 (there 128)" in told) == (latent == 16) and "noise_std=" not in told


@pytest.mark.parametrize("where", ["checkpoint", "manifest"])
def test_statistics_are_the_data_s_digit_for_digit(tmp_path: Path, where: str) -> None:
    folder = a_set(tmp_path / "a", 3, material=True)
    moments = read_manifest(folder).statistics
    more = {"frame_statistics": moments, "manifest_sha256": "moved"} if where == "checkpoint" else {}
    trained(folder, tmp_path / "a.ckpt", **more)
    metadata = metadata_of(export_weights(tmp_path / "a.ckpt", tmp_path / "there/model-0.pt").parent)
    for key, name, unit in (("vel", "velocity", 0.01), ("acc", "acceleration", 0.01**2)):
        for moment in ("mean", "std"):
            assert metadata[f"{key}_{moment}"] == [value * unit for value in moments[name][moment]]


def test_imported_weights_go_back_with_their_own_metadata(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metadata = {**weights_metadata(3), "bounds": [[0.0, 1.0], [-1.0, 2.0], [0.0, 0.7]], "sequence_length": 320}
    imported(saved(tmp_path / "m", random_weights(3), metadata), tmp_path / "a.ckpt", noise_std=1e-4)
    back = metadata_of(export_weights(tmp_path / "a.ckpt", tmp_path / "b/model-0.pt").parent)
    assert {key: back[key] for key in metadata} == metadata, "to the last digit"
    assert "give their program noise_std=0.0001" in capsys.readouterr().out
    parts = {"train": metadata, "rollout": {**metadata, "vel_mean": [9.0] * 3, "bounds": [[0.0, 9.0]] * 3}}
    imported(saved(tmp_path / "n", random_weights(3), parts), tmp_path / "c.ckpt", scale=0.5, gravity_axis="x")
    back = metadata_of(export_weights(tmp_path / "c.ckpt", tmp_path / "d/model-0.pt").parent)
    assert back["bounds"] == [[-0.5, 1.0], [0.0, 0.35], [0.0, 0.5]]
    assert back["vel_mean"] == [0.5 * metadata["vel_mean"][axis] for axis in (1, 2, 0)], "those of the training"


def test_box_and_length_are_asked_for(tmp_path: Path) -> None:
    metadata = {key: value for key, value in weights_metadata(3).items() if key not in ("bounds", "sequence_length")}
    imported(saved(tmp_path / "m", random_weights(3), metadata), tmp_path / "a.ckpt")
    target = tmp_path / "b/model-0.pt"
    with pytest.raises(InputError, match=r"in which box its trajectories are and how long; .*weights\.data=FOLDER"):
        export_weights(tmp_path / "a.ckpt", target)
    assert not target.parent.exists()
    several = write_ours(tmp_path / "s", {"train": [a_flight(a_scene()), a_flight(DIFFERENT["box"])]})
    with pytest.raises(InputError, match=r"trajectory_0001\.h5: its box is .*give one box for all: lower=… upper=…"):
        export_weights(tmp_path / "a.ckpt", target, data=str(several))
    export_weights(tmp_path / "a.ckpt", target, data=str(several), lower=[0, 0, 0], upper=[1, 2, 3])
    written = metadata_of(target.parent)
    assert written["bounds"] == [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]] and written["sequence_length"] == 8
    with pytest.raises(InputError, match="lower= and upper= belong together"):
        export_weights(tmp_path / "a.ckpt", tmp_path / "c/model-0.pt", lower=[0, 0, 0])
    with pytest.raises(InputError, match="does not fit 3 dimensions"):
        export_weights(tmp_path / "a.ckpt", tmp_path / "c/model-0.pt", lower=[0, 0], upper=[1, 1])
    assert json.loads(json.dumps(load_checkpoint(tmp_path / "a.ckpt").provenance["weights"]["axes"])) == [0, 1, 2]
