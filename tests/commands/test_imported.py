"""From somebody else's data to a judged model, as a user types it: convert, train, evaluate."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from gns_pl.io import read_manifest, read_trajectory
from gns_pl.models.checkpoint import load_checkpoint, load_simulator
from tests.commands.in_process import ROOT, call
from tests.commands.test_train import read_rows
from tests.convert.formats import fixtures
from tests.convert.test_weights import a_state, random_weights

SMALL = [
    "model=small", "model.latent_size=8", "model.num_message_passing_steps=1", "model.connectivity_radius=0.15",
    "training.optimisation.num_steps=4", "training.optimisation.warmup_steps=1", "training.optimisation.unroll_steps=2",
    "trainer.val_check_interval=2", "trainer.accelerator=cpu", "training.num_workers=0", "~logger.wandb",
    "hydra.run.dir=runs/theirs",
]  # fmt: skip


def command(folder: Path, name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return call(folder, name, *arguments)


def with_obstacle(dim: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A falling body, and a row of kinematic particles below it that swings along x."""
    body = fixtures.falling(10, dim=dim, seed=seed, dt=0.02)
    row = np.full((10, 4, dim), 0.5, dtype=np.float32)
    row[:, :, 0] = 0.2 + 0.1 * np.arange(4) + 0.05 * np.sin(np.arange(10))[:, None]
    row[:, :, -1] = 0.05
    position = np.concatenate([row, body], axis=1).astype(np.float32)
    return position, np.where(np.arange(position.shape[1]) < 4, 3, 6)


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_convert_train_evaluate(tmp_path: Path, dim: int) -> None:
    scenes = [with_obstacle(dim, seed) for seed in range(4)]
    sets = {"train": scenes[:2], "valid": scenes[2:3], "test": scenes[3:]}
    positions = {split: [position for position, _ in each] for split, each in sets.items()}
    fixtures.write_geoelements(tmp_path / "theirs", positions, scenes[0][1], np.float64(0.5))
    metadata = json.loads((tmp_path / "theirs/metadata.json").read_text())
    (tmp_path / "theirs/metadata.json").write_text(json.dumps({**metadata, "dt": 0.02}))
    made = command(
        tmp_path, "convert.py", "source=theirs", "target=datasets/theirs", "trust=true", "material_value=tan"
    )
    assert made.returncode == 0, made.stderr
    trained = command(tmp_path, "train.py", "data=datasets/theirs", *SMALL)
    assert trained.returncode == 0, trained.stderr
    checkpoint = load_checkpoint(tmp_path / "runs/theirs/last.ckpt")
    config = checkpoint.simulator.config
    assert config.particle_types == (3, 6) and config.dim == dim and config.material_features == ("tan_friction_angle",)
    assert checkpoint.data["root"] == "datasets/theirs" and checkpoint.data["imported"]["format"] == "geoelements/gns"
    [log] = (tmp_path / "runs/theirs/csv").glob("*/metrics.csv")
    assert any(float(row["valid/position_error"] or "nan") >= 0 for row in read_rows(log))

    figures = f"evaluation.figures={'true' if dim == 2 else 'false'}"
    options = ("ckpt=runs/theirs/last.ckpt", figures, "evaluation.save_trajectories=true", "logger.enabled=false")
    judged = command(tmp_path, "evaluate.py", *options, "evaluation.split=test")
    assert judged.returncode == 0, judged.stderr
    folder = tmp_path / "runs/theirs/evaluation"
    document = json.loads((folder / "metrics.json").read_text())
    assert list(document["scenes"]) == ["test_0000"]
    assert document["scenes"]["test_0000"]["errors"]["learned"]["position_error"] is not None
    learned = read_trajectory(folder / "learned_test_0000.h5").position
    np.testing.assert_array_equal(learned[:, :4], positions["test"][0][:, :4])  # the obstacle keeps to its script
    assert not np.array_equal(learned[:, 4:], positions["test"][0][:, 4:])


@pytest.mark.slow
def test_without_a_split_imported_data_are_judged_on_their_tests(tmp_path: Path) -> None:
    scenes = [with_obstacle(2, seed)[0] for seed in range(3)]
    (tmp_path / "plain").mkdir()
    for number, position in enumerate(scenes):
        np.savez(tmp_path / f"plain/{number}.npz", position=position, particle_type=with_obstacle(2, 0)[1])
    box = ("lower=[0,0]", "upper=[1,1]", "dt=0.02")
    made = command(tmp_path, "convert.py", "source=plain", "target=theirs", *box)
    assert made.returncode == 0, made.stderr
    advised = command(tmp_path, "train.py", "data=theirs", "advise=true", *SMALL)
    assert advised.returncode == 0 and "neighbours" in advised.stdout, advised.stderr
    trained = command(tmp_path, "train.py", "data=imported", "data.root=theirs", *SMALL, "training.stride=2")
    assert trained.returncode == 0, trained.stderr
    judged = command(
        tmp_path, "evaluate.py", "ckpt=runs/theirs/last.ckpt", "evaluation.figures=false", "logger.enabled=false"
    )
    assert judged.returncode == 0 and "judged on their test trajectories" in judged.stdout, judged.stderr
    refused = command(
        tmp_path, "evaluate.py", "ckpt=runs/theirs/last.ckpt", f"evaluation.scenes=[{ROOT / 'scenes/two_blocks.yaml'}]"
    )
    assert refused.returncode == 2 and "evaluation.split=test" in refused.stderr


def test_a_folder_that_is_no_data_set(tmp_path: Path) -> None:
    refused = command(tmp_path, "train.py", "data=imported", *SMALL)
    assert refused.returncode == 2 and "data=datasets/NAME" in refused.stderr and "Traceback" not in refused.stderr
    refused = command(tmp_path, "train.py", "data=imported", "data.root=nowhere", *SMALL)
    assert refused.returncode == 2 and "holds no data set" in refused.stderr


def test_weights_of_geoelements_are_judged_and_simulate(tmp_path: Path) -> None:
    scenes = [with_obstacle(3, seed)[0] for seed in range(3)]
    positions = {"train": scenes[:1], "valid": scenes[1:2], "test": scenes[2:]}
    fixtures.write_geoelements(tmp_path / "theirs", positions, with_obstacle(3, 0)[1], np.float64(0.5))
    metadata = json.loads((tmp_path / "theirs/metadata.json").read_text())
    (tmp_path / "theirs/metadata.json").write_text(json.dumps({**metadata, "dt": 0.02}))
    torch.save(random_weights(3, material=True), tmp_path / "theirs/model-500.pt")
    made = command(tmp_path, "convert.py", "source=theirs", "target=ours", "trust=true", "material_value=tan")
    assert made.returncode == 0, made.stderr
    told = command(tmp_path, "convert.py", "source=theirs/model-500.pt", "inspect=true")
    assert told.returncode == 0 and "3 message-passing steps" in told.stdout and not (tmp_path / "a.ckpt").exists()
    more = ("weights.data=ours", "weights.edge_update=residual")
    carried = command(tmp_path, "convert.py", "source=theirs/model-500.pt", "target=a.ckpt", *more)
    assert carried.returncode == 0 and "One-step error on ours" in carried.stdout, carried.stderr
    off = ("evaluation.figures=false", "logger.enabled=false")
    judged = command(tmp_path, "evaluate.py", "ckpt=a.ckpt", "evaluation.split=test", *off)
    assert judged.returncode == 0, judged.stderr
    document = json.loads((tmp_path / "evaluation/metrics.json").read_text())
    assert document["checkpoint"]["data"]["root"] == "ours" and list(document["scenes"]) == ["test_0000"]
    scene = ("scene=column_collapse", "scene.length=0.5", "scene.aspect_ratio=0.8", "duration=0.06", "device=cpu")
    run = command(tmp_path, "simulate.py", "ckpt=a.ckpt", *scene)
    assert run.returncode == 0, run.stderr
    name = "column_collapse_aspect_ratio_0.8_length_0.5.h5"
    assert read_trajectory(tmp_path / "runs/simulate" / name).num_frames >= 2
    for each in (carried, judged, run):
        assert "their own program starts from 6 true frames" in each.stdout
        assert "evaluation.start=frames" in each.stdout
    back = command(tmp_path, "convert.py", "source=a.ckpt", "target=out/model-0.pt")
    assert back.returncode == 0, back.stderr
    written = json.loads((tmp_path / "out/metadata.json").read_text())
    for key in ("bounds", "sequence_length", "vel_mean", "vel_std", "acc_mean", "acc_std", "dim"):
        assert written[key] == metadata[key]
    first, second = (
        torch.load(tmp_path / path, weights_only=True) for path in ("theirs/model-500.pt", "out/model-0.pt")
    )
    assert all(torch.equal(first[name], second[name]) for name in first)


@pytest.mark.slow
def test_what_is_trained_with_their_features_goes_there(tmp_path: Path) -> None:
    """Trained here, exported, imported again: the same step."""
    scenes = [with_obstacle(2, seed) for seed in range(3)]
    sets = {split: [scenes[k][0]] for k, split in enumerate(("train", "valid", "test"))}
    fixtures.write_geoelements(tmp_path / "theirs", sets, scenes[0][1])
    made = command(tmp_path, "convert.py", "source=theirs", "target=ours", "trust=true", "dt=0.02")
    assert made.returncode == 0, made.stderr
    small = ["model=geoelements", *(each for each in SMALL if each != "model=small")]
    trained = command(tmp_path, "train.py", "data=ours", *small)
    assert trained.returncode == 0, trained.stderr
    gone = command(tmp_path, "convert.py", "source=runs/theirs/last.ckpt", "target=out/model-4.pt")
    assert gone.returncode == 0, gone.stderr
    written, manifest = json.loads((tmp_path / "out/metadata.json").read_text()), read_manifest(tmp_path / "ours")
    assert written["vel_std"] == [value * 0.02 for value in manifest.statistics["velocity"]["std"]]
    assert written["bounds"] == [[0.0, 1.0]] * 2 and written["sequence_length"] == 10
    back = command(
        tmp_path, "convert.py", "source=out/model-4.pt", "target=b.ckpt", "weights.edge_update=residual", "spacing=0.1"
    )
    assert back.returncode == 0, back.stderr
    first, second = (load_simulator(tmp_path / path) for path in ("runs/theirs/last.ckpt", "b.ckpt"))
    history, static = a_state(2)
    with torch.no_grad():
        torch.testing.assert_close(first(history, static), second(history, static), atol=1e-6, rtol=0)
    still = 2 * history[:, -1] - history[:, -2]
    assert (first(history, static) - still)[4:].abs().max() > 1e-5
