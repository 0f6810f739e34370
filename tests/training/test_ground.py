"""A simulator that sees surfaces: trained on ground with obstacles, resumed to the bit, and run by users."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from omegaconf import DictConfig, open_dict

from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.rollout.failure import first_failure
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.training.resume import find_resume
from gns_pl.training.train import train
from tests.training.conftest import assert_same, make_config

GROUND = {
    "ground_release": {
        "count": 3,
        "valid": 1,
        "test": 0,
        "duration": 0.2,
        "domain": [1.0, 0.5, 0.7],
        "length": [0.25, 0.3],
        "height": [0.15, 0.2],
        "incline_deg": [15.0, 25.0],
        "friction": [0.3, 0.6],
        "hill": 0.03,
        "barrier": 1.0,
    }
}
SURFACES = (
    "model.walls=contacts",
    "model.output=switched",
    "model.input_sequence_length=2",
    "training.rollout.num_steps=3",
)


def config(root: Path, output: Path, *overrides: str) -> DictConfig:
    cfg = make_config(
        root, output, *SURFACES, "training.rollout.scenes=2", "training.optimisation.symmetry=true", *overrides
    )
    with open_dict(cfg):
        cfg.data.families = GROUND
    return cfg


@pytest.fixture(scope="module")
def ground_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "ground"


@pytest.fixture(scope="module")
def trained(ground_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ground")
    train(config(ground_root, folder), folder, None)
    return folder


def state(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = torch.load(folder / "last.ckpt", weights_only=True)
    return content


@pytest.mark.parametrize("cut", [2, 5])  # among windows, and among whole runs
def test_a_resumed_training_is_the_whole_one(cut: int, trained: Path, ground_root: Path, tmp_path: Path) -> None:
    train(config(ground_root, tmp_path, f"trainer.max_steps={cut}"), tmp_path, None)
    train(config(ground_root, tmp_path), tmp_path, find_resume("auto", tmp_path))
    assert_same(state(tmp_path), state(trained))


def test_users_run_it_on_ground(trained: Path, ground_root: Path) -> None:
    """Nobody ends in the ground or in the barrier, and runs together are those alone."""
    solver = LearnedSolver("ground", trained / "last.ckpt")
    scenes = [read_trajectory(ground_root / name, num_frames=1).scene for name in read_manifest(ground_root).files]
    assert all(scene.terrain is not None and scene.obstacles for scene in scenes)
    assert all(solver.unsupported_reason(scene) is None for scene in scenes)
    runs = solver.run_many(scenes, num_steps=6)
    for scene, run in zip(scenes, runs, strict=True):
        assert first_failure(run) is None
        np.testing.assert_allclose(solver.run(scene, num_steps=6).position, run.position, atol=1e-5)


def test_state_has_a_name_for_every_column(trained: Path) -> None:
    simulator = load_checkpoint(trained / "last.ckpt").simulator
    stored = simulator.config.to_dict()
    assert (stored["walls"], stored["output"]) == ("contacts", "switched")
    names = simulator.state_names()
    assert names[3:9] == ["surfaces"] * 3 + ["friction of surfaces"] * 3


def test_weights_from_before_contacts_were_behind_the_network_are_refused_with_what_to_do(
    trained: Path, tmp_path: Path
) -> None:
    content = torch.load(trained / "last.ckpt", weights_only=True)
    last = [name for name in content["state_dict"] if "decoder" in name][-2:]
    for name in last:  # q of contacts (1 + q) Σ w j
        weight = content["state_dict"][name]
        content["state_dict"][name] = torch.cat([weight, weight[:1]])
    torch.save(content, tmp_path / "old.ckpt")
    with pytest.raises(InputError, match="before contacts came behind the network's forces: then train it again"):
        load_checkpoint(tmp_path / "old.ckpt")


def test_a_simulator_of_boxes_is_not_trained_on_ground(ground_root: Path, trained: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has obstacles, which .* does not know; set model\.walls=contacts"):
        train(config(ground_root, tmp_path, "model.walls=box"), tmp_path, None)
