"""Weights of geoelements/gns: the reference arithmetic is written here from its description, in float64."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import layer_norm

from gns_pl.convert import weights as carrying
from gns_pl.convert.weights_export import export_weights
from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, radius_graph
from gns_pl.models.checkpoint import KEY, load_checkpoint, load_simulator, save_checkpoint
from gns_pl.models.geoelements import FrameSimulator, with_self_loops
from gns_pl.rollout import rollout
from gns_pl.rollout.acceleration import accelerate
from gns_pl.rollout.stabilise import stabilise
from tests.convert.formats import fixtures
from tests.convert.test_convert import converted

NOISE = 6.7e-4
RADIUS = 0.15


def metadata_of(dim: int, seed: int = 3) -> dict[str, Any]:
    generator = np.random.default_rng(seed)
    return {
        "bounds": [[0.0, 1.0]] * dim,
        "sequence_length": 320,
        "default_connectivity_radius": RADIUS,
        "dim": dim,
        "dt": 0.01,
        "boundary_augment": 1.5,
        "vel_mean": generator.normal(0, 1e-3, dim).tolist(),
        "vel_std": generator.uniform(1e-3, 3e-3, dim).tolist(),
        "acc_mean": generator.normal(0, 1e-4, dim).tolist(),
        "acc_std": generator.uniform(1e-4, 3e-4, dim).tolist(),
    }


def random_weights(
    dim: int, *, latent: int = 16, layers: int = 3, hidden: int = 2, material: bool = False, seed: int = 0
) -> dict[str, Tensor]:
    """A state_dict with the names and shapes of theirs."""
    generator = torch.Generator().manual_seed(seed)
    weights: dict[str, Tensor] = {"_particle_type_embedding.weight": torch.randn(9, 16, generator=generator)}

    def mlp(name: str, width: int, out: int, *, norm: bool) -> None:
        sizes = [width, *[latent] * hidden, out]
        inner = f"_encode_process_decode.{name}" + (".0" if norm else "")
        for place in range(hidden + 1):
            scale = sizes[place] ** -0.5
            weights[f"{inner}.NN-{place}.weight"] = scale * torch.randn(
                sizes[place + 1], sizes[place], generator=generator
            )
            weights[f"{inner}.NN-{place}.bias"] = 0.1 * torch.randn(sizes[place + 1], generator=generator)
        if norm:
            weights[f"_encode_process_decode.{name}.1.weight"] = 1 + 0.1 * torch.randn(out, generator=generator)
            weights[f"_encode_process_decode.{name}.1.bias"] = 0.1 * torch.randn(out, generator=generator)

    mlp("_encoder.node_fn", 5 * dim + 2 * dim + 16 + int(material), latent, norm=True)
    mlp("_encoder.edge_fn", dim + 1, latent, norm=True)
    for layer in range(layers):
        mlp(f"_processor.gnn_stacks.{layer}.edge_fn", 3 * latent, latent, norm=True)
        mlp(f"_processor.gnn_stacks.{layer}.node_fn", 2 * latent, latent, norm=True)
    mlp("_decoder.node_fn", latent, dim, norm=False)
    return weights


def their_step(
    weights: dict[str, Tensor],
    metadata: dict[str, Any],
    history: Tensor,
    types: Tensor,
    material: Tensor | None,
    *,
    doubling: bool,
    noise: float = NOISE,
) -> tuple[Tensor, Tensor]:
    """Normalised acceleration and next position [N, D] in their units, particle by particle and edge by edge."""
    weights = {name: value.double() for name, value in weights.items()}
    history = history.double()
    stats = {key: torch.tensor(metadata[key], dtype=torch.float64) for key in metadata if key[:4] in ("vel_", "acc_")}
    vel_std, acc_std = ((stats[f"{k}_std"] ** 2 + noise**2).sqrt() for k in ("vel", "acc"))
    position = history[:, -1]
    velocity = (history[:, 1:] - history[:, :-1] - stats["vel_mean"]) / vel_std
    bounds = torch.tensor(metadata["bounds"], dtype=torch.float64)
    walls = torch.cat([position - bounds[:, 0], bounds[:, 1] - position], dim=1) / RADIUS
    clip = metadata.get("boundary_augment", 1.0)
    node = [velocity.flatten(1), walls.clamp(-clip, clip), weights["_particle_type_embedding.weight"][types]]
    node = torch.cat([*node, *([] if material is None else [material.double()])], dim=1)
    difference = position[:, None] - position[None]
    receiver, sender = torch.nonzero(difference.norm(dim=2) < RADIUS, as_tuple=True)  # each particle with itself, too
    relative = (position[sender] - position[receiver]) / RADIUS
    edge = torch.cat([relative, relative.norm(dim=1, keepdim=True)], dim=1)

    def mlp(name: str, value: Tensor, *, norm: bool = True) -> Tensor:
        place, inner = 0, f"_encode_process_decode.{name}" + (".0" if norm else "")
        while f"{inner}.NN-{place}.weight" in weights:
            value = value.clamp(min=0) if place else value
            value = value @ weights[f"{inner}.NN-{place}.weight"].T + weights[f"{inner}.NN-{place}.bias"]
            place += 1
        if norm:
            outer = f"_encode_process_decode.{name}.1"
            value = layer_norm(value, value.shape[1:], weights[f"{outer}.weight"], weights[f"{outer}.bias"])
        return value

    node, edge = mlp("_encoder.node_fn", node), mlp("_encoder.edge_fn", edge)
    layer = 0
    while f"_encode_process_decode._processor.gnn_stacks.{layer}.edge_fn.1.bias" in weights:
        place = f"_processor.gnn_stacks.{layer}"
        message = mlp(f"{place}.edge_fn", torch.cat([node[receiver], node[sender], edge], dim=1))
        summed = torch.zeros_like(node).index_add(0, receiver, message)
        node = node + mlp(f"{place}.node_fn", torch.cat([summed, node], dim=1))
        edge = 2 * edge if doubling else edge + message
        layer += 1
    output = mlp("_decoder.node_fn", node, norm=False)
    acceleration = output * acc_std + stats["acc_mean"]
    return output, position + (position - history[:, -2]) + acceleration


def a_state(dim: int, number: int = 40, seed: int = 5) -> tuple[Tensor, SceneBatch]:
    """A crowd of moving particles of several types in a unit box, two of them at walls."""
    generator = torch.Generator().manual_seed(seed)
    start = 0.2 + 0.4 * torch.rand(number, 1, dim, generator=generator)
    start[0], start[1] = 0.02, 0.97
    history = start + (0.003 * torch.randn(number, 6, dim, generator=generator)).cumsum(dim=1)
    gravity = [0.0] * (dim - 1) + [-9.81]
    static = SceneBatch(
        particle_type=torch.where(torch.arange(number) < 4, 5, 6),
        material=torch.rand(number, 1, generator=generator),
        volume=torch.full((number,), 1e-3),
        lower=torch.zeros(1, dim),
        upper=torch.ones(1, dim),
        gravity=torch.tensor([gravity]),
        batch=torch.zeros(number, dtype=torch.int64),
    )
    return history, static


def saved(folder: Path, weights: dict[str, Tensor], metadata: dict[str, Any]) -> Path:
    folder.mkdir(exist_ok=True)
    torch.save(weights, folder / "model-1000.pt")
    (folder / "metadata.json").write_text(json.dumps(metadata))
    return folder / "model-1000.pt"


def imported(source: Path, target: Path, **options: Any) -> FrameSimulator:
    settings = {"edge_update": "residual", "noise_std": NOISE, "spacing": 0.07, **options}
    simulator = load_simulator(carrying.import_weights(source, target, **settings))
    assert isinstance(simulator, FrameSimulator)
    return simulator


@pytest.mark.parametrize("edge_update", ["residual", "legacy_doubling"])
@pytest.mark.parametrize(("dim", "material"), [(2, False), (3, False), (3, True)])
def test_a_step_equals_theirs(tmp_path: Path, dim: int, material: bool, edge_update: str) -> None:
    weights, metadata = random_weights(dim, material=material), metadata_of(dim)
    simulator = imported(saved(tmp_path / "m", weights, metadata), tmp_path / "a.ckpt", edge_update=edge_update)
    history, static = a_state(dim)
    values = static.material if material else None
    doubling = edge_update == "legacy_doubling"
    output, position = their_step(weights, metadata, history, static.particle_type, values, doubling=doubling)
    with torch.no_grad():  # the loops in blocks, and PyG's own
        for compiled in (True, False):
            simulator.network.compiled_edges = compiled
            torch.testing.assert_close(
                simulator.normalised_acceleration(history, static).double(), output, atol=1e-5, rtol=1e-5
            )
            torch.testing.assert_close(simulator(history, static).double(), position, atol=1e-6, rtol=0)
    other, _ = their_step(weights, metadata, history, static.particle_type, values, doubling=not doubling)
    assert (other - output).abs().max() > 0.05, "the two ways differ by far more than the tolerance"


@pytest.mark.parametrize("edge_update", ["residual", "legacy_doubling"])
def test_the_whole_size_of_theirs(tmp_path: Path, edge_update: str) -> None:
    weights, metadata = random_weights(3, latent=128, layers=10), metadata_of(3)
    simulator = imported(saved(tmp_path / "m", weights, metadata), tmp_path / "a.ckpt", edge_update=edge_update)
    assert simulator.node_width() == 37
    history, static = a_state(3)
    output, position = their_step(
        weights, metadata, history, static.particle_type, None, doubling=edge_update == "legacy_doubling"
    )
    with torch.no_grad():
        found = simulator.normalised_acceleration(history, static).double()
        assert (found - output).abs().max() < 1e-5 * output.abs().max()
        torch.testing.assert_close(simulator(history, static).double(), position, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("axis", "scale"), [("x", 1.0), ("y", 0.0125), ("z", 80.0)])
def test_other_units_and_axes_are_the_same_model(tmp_path: Path, axis: str, scale: float) -> None:
    weights, metadata = random_weights(3), metadata_of(3)
    simulator = imported(saved(tmp_path / "m", weights, metadata), tmp_path / "a.ckpt", gravity_axis=axis, scale=scale)
    history, static = a_state(3)
    output, position = their_step(weights, metadata, history, static.particle_type, None, doubling=False)
    axes = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}[axis]
    ours = SceneBatch(**{**{k: getattr(static, k) for k in ("particle_type", "material", "volume", "gravity", "batch")},
                     "lower": static.lower * scale, "upper": static.upper * scale})  # fmt: skip
    with torch.no_grad():
        turned = history[:, :, axes] * scale
        torch.testing.assert_close(
            simulator.normalised_acceleration(turned, ours).double(), output[:, axes], atol=2e-5, rtol=2e-5
        )
        torch.testing.assert_close(simulator(turned, ours).double() / scale, position[:, axes], atol=1e-6, rtol=0)
    assert simulator.config.connectivity_radius == pytest.approx(RADIUS * scale)


@pytest.mark.parametrize("edge_update", ["residual", "legacy_doubling"])
def test_there_and_back(tmp_path: Path, edge_update: str) -> None:
    weights, metadata = random_weights(3, material=True), metadata_of(3)
    imported(saved(tmp_path / "m", weights, metadata), tmp_path / "a.ckpt", edge_update=edge_update)
    back = export_weights(tmp_path / "a.ckpt", tmp_path / "out/model-0.pt")
    again = torch.load(back, weights_only=True)
    assert set(again) == set(weights)
    for name, value in weights.items():
        torch.testing.assert_close(again[name], value, atol=0, rtol=0)
    written = json.loads((tmp_path / "out/metadata.json").read_text())
    for key in ("vel_mean", "vel_std", "acc_mean", "acc_std", "default_connectivity_radius", "boundary_augment"):
        np.testing.assert_allclose(written[key], metadata[key], rtol=1e-5, atol=1e-9)
    assert written["bounds"] == metadata["bounds"] and written["sequence_length"] == 320 and written["dt"] == 0.01
    assert written["nnode_in"] == 38 and written["nedge_in"] == 4 and written["noise_std"] == pytest.approx(NOISE)


def test_models_of_ours_with_other_features_do_not_fit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not fit geoelements/gns: its network gives accelerations less gravity"):
        export_weights(Path("collapse"), tmp_path / "model-0.pt")
    assert not list(tmp_path.iterdir())


def test_the_way_of_updating_edges_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = saved(tmp_path / "m", random_weights(3), metadata_of(3))
    imported(source, tmp_path / "a.ckpt", edge_update=None)
    told = capsys.readouterr().out
    assert "Warning: weights.edge_update is not given" in told and "legacy_doubling" in told
    assert load_checkpoint(tmp_path / "a.ckpt").provenance["weights"]["edge_update"].startswith("unknown")
    imported(source, tmp_path / "b.ckpt")
    assert "Warning" not in capsys.readouterr().out
    with pytest.raises(InputError, match=r"weights\.edge_update must be one of residual, legacy_doubling"):
        imported(source, tmp_path / "c.ckpt", edge_update="doubled")


class Hostile:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch hacked",)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda w, m: w.update(a=Hostile()), "holds no plain weights"),
        (lambda w, m: w.clear(), "is no state_dict|not weights of geoelements"),
        (lambda w, m: w.popitem(), "for 16 dimensions"),
        (lambda w, m: w.update(extra=torch.zeros(1)), "has extra, which their networks do not have"),
        (lambda w, m: w["_particle_type_embedding.weight"].fill_(math.nan), "not finite"),
        (lambda w, m: w.update({"_particle_type_embedding.weight": torch.zeros(9, 11)}), "node and 4 edge features"),
        (lambda w, m: m.pop("vel_std"), "lacks vel_std"),
        (lambda w, m: m.update(acc_std=[1.0, 2.0]), "acc_std must be 3 finite numbers"),
        (lambda w, m: m.pop("default_connectivity_radius"), "lacks default_connectivity_radius"),
        (lambda w, m: m.pop("dt"), r"give dt=0\.0025"),
    ],
)
def test_what_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: Any, sentence: str) -> None:
    monkeypatch.chdir(tmp_path)
    weights, metadata = random_weights(3), metadata_of(3)
    spoil(weights, metadata)
    source = saved(tmp_path / "m", weights, metadata)
    with pytest.raises(InputError, match=sentence):
        imported(source, tmp_path / "a.ckpt")
    assert [path.name for path in tmp_path.iterdir()] == ["m"]


def test_truncated_weights(tmp_path: Path) -> None:
    source = saved(tmp_path / "m", random_weights(2), metadata_of(2))
    content = source.read_bytes()
    for size in (0, 10, len(content) // 2, len(content) - 1):
        source.write_bytes(content[:size])
        with pytest.raises(InputError, match=r"model-1000\.pt"):
            imported(source, tmp_path / "a.ckpt")


def test_rollouts_hold_kinematic_particles_and_know_their_limits(tmp_path: Path) -> None:
    scenes = [fixtures.falling(8, seed=seed) for seed in range(3)]
    types = np.where(np.arange(64) < 5, 3, 6)
    theirs = fixtures.write_geoelements(tmp_path / "theirs", {"train": scenes[:2], "test": scenes[2:]}, types)
    ours = converted(theirs, tmp_path / "ours")
    source = saved(tmp_path / "m", random_weights(3), metadata_of(3))
    simulator = imported(source, tmp_path / "a.ckpt", data=str(ours), spacing=None)
    assert load_checkpoint(tmp_path / "a.ckpt").data["root"] == str(ours)
    from gns_pl.io import read_trajectory

    truth = read_trajectory(ours / "test_0000.h5")
    made = rollout(simulator, truth, 7)
    np.testing.assert_array_equal(made.position[:, :5], truth.position[: made.num_frames, :5])
    skinned = rollout(accelerate(simulator, skin=0.3), truth, 7)
    np.testing.assert_allclose(skinned.position, made.position, atol=1e-6)
    with pytest.raises(InputError, match="edges from a particle to itself"):
        accelerate(simulator, captured=True)
    assert stabilise(simulator, sleep=0.1, energy_limiter=True) is simulator


def test_data_tell_which_way_is_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Frames that legacy weights made themselves are predicted without error by no other way."""
    weights, metadata = random_weights(2), metadata_of(2)
    history, static = a_state(2)
    frames = list(history.transpose(0, 1))
    for _ in range(6):
        window = torch.stack(frames[-6:], dim=1)
        frames.append(their_step(weights, metadata, window, static.particle_type, None, doubling=True)[1].float())
    (tmp_path / "plain").mkdir()
    np.savez(tmp_path / "plain/a.npz", position=torch.stack(frames), particle_type=static.particle_type.numpy())
    more = {"dt": 0.01, "lower": (0.0, 0.0), "upper": (1.0, 1.0), "gravity": 9.81, "gravity_axis": "z", "scale": 1}
    ours = converted(tmp_path / "plain", tmp_path / "ours", **more)
    capsys.readouterr()
    imported(saved(tmp_path / "m", weights, metadata), tmp_path / "a.ckpt", edge_update=None, data=str(ours))
    told = capsys.readouterr().out
    residual, legacy = (float(re.search(rf"{way} ([\d.e-]+)", told)[1]) for way in ("residual", "legacy_doubling"))  # type: ignore[index]
    assert legacy < 1e-3 < 0.1 < residual
    assert "the right way has the smaller one: weights.edge_update=legacy_doubling." in told
    # Weights of another training explain nothing of these data, whichever way they are read.
    imported(saved(tmp_path / "n", random_weights(2, seed=9), metadata), tmp_path / "b.ckpt", data=str(ours))
    told = capsys.readouterr().out
    assert all(float(re.search(rf"{way} ([\d.e-]+)", told)[1]) > 1 for way in ("residual", "legacy_doubling"))  # type: ignore[index]
    assert "right way" not in told and "neither way explains these data. Check that" in told


def test_data_at_rest_tell_no_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = np.repeat(fixtures.falling(1, dim=2), 9, axis=0)
    (tmp_path / "plain").mkdir()
    np.savez(tmp_path / "plain/a.npz", position=still)
    more = {"dt": 0.01, "lower": (0.0, 0.0), "upper": (1.0, 1.0), "gravity": 9.81, "gravity_axis": "z", "scale": 1}
    ours = converted(tmp_path / "plain", tmp_path / "ours", **more)
    imported(saved(tmp_path / "m", random_weights(2), metadata_of(2)), tmp_path / "a.ckpt", data=str(ours))
    told = capsys.readouterr().out
    assert "nothing tells which way is right" in told and "nan" not in told


def test_self_loops_stand_where_the_order_wants_them() -> None:
    position = torch.rand(50, 3)
    edges = with_self_loops(radius_graph(position, 0.3), 50)
    key = edges[1] * 50 + edges[0]
    assert (key.diff() > 0).all()
    assert (edges[0] == edges[1]).sum() == 50


def test_earlier_versions_refuse_the_new_kind(tmp_path: Path) -> None:
    imported(saved(tmp_path / "m", random_weights(2), metadata_of(2)), tmp_path / "a.ckpt")
    content = torch.load(tmp_path / "a.ckpt", weights_only=True)
    assert content[KEY]["format_version"] == 4 and content[KEY]["kind"] == "frames"
    content[KEY]["kind"] = "waves"
    torch.save(content, tmp_path / "b.ckpt")
    with pytest.raises(
        InputError, match=r"model\.kind must be one of frames, simulator, or .* of your own, not 'waves'"
    ):
        load_checkpoint(tmp_path / "b.ckpt")
    checkpoint = load_checkpoint("collapse")
    save_checkpoint(tmp_path / "c.ckpt", checkpoint)
    assert torch.load(tmp_path / "c.ckpt", weights_only=True)[KEY]["format_version"] == 3
