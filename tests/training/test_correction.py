"""Coarse runs that follow fine ones, and a network that learns what they miss, trained as any simulator is."""

from __future__ import annotations

import math
import signal
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf, open_dict

from gns_pl.errors import InputError
from gns_pl.generation import generate_dataset
from gns_pl.generation.thinning import thin_trajectory
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.models.corrector import Corrector, CorrectorConfig, load_corrector
from gns_pl.mpm.settings import run_solver
from gns_pl.rollout import static_of
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.solvers.corrected import CorrectedSolver
from gns_pl.solvers.correction import corrected_run, followed_run
from gns_pl.training.advice import advise
from gns_pl.training.correction import runout_error
from gns_pl.training.followed import Example, fit_scales, make_examples
from gns_pl.training.resume import find_resume
from gns_pl.training.summary import objective, read_summary
from gns_pl.training.train import train
from gns_pl.trajectory import Trajectory
from tests.conftest import MPM, SAND
from tests.data import sets
from tests.training.conftest import CONF, assert_same, rows
from tests.training.test_stopping import callback

COARSE = {**MPM, "cell_size": 1 / 8}
CONFIG = CorrectorConfig(
    dim=2,
    interval=0.02,
    spacing=1 / 16,
    mpm=COARSE,
    connectivity_radius=0.15,
    latent_size=16,
    num_mlp_layers=1,
    num_message_passing_steps=2,
    velocity_threshold=0.1,
)
FAMILY = {"kind": "column_collapse", "domain": [1.5, 0.75], "length": [0.375, 0.375], "duration_tau": 5.0}
DATA = {
    "name": "tiny",
    "seed": 0,
    "frame_interval": 0.02,
    "store_every": [3],
    "every": 3,
    "gravity": 9.81,
    "material": dict(vars(SAND)),
    "walls": {face: {"condition": "friction", "friction": 0.385} for face in FACES[2]},
    "mpm": {**MPM, "cell_size": 1 / 24},
    "families": {"low": {**FAMILY, "aspect_ratio": [1.2, 1.5], "count": 9, "valid": 1, "test": 0}},
}
TINY = [
    "+experiment=corrected_plane",
    "logger=csv",
    "name=tiny",
    "model.connectivity_radius=0.15",
    "model.latent_size=16",
    "model.num_message_passing_steps=2",
    "model.velocity_threshold=0.1",
    "training.stride=1",
    "training.batch_size=2",
    "training.num_train=3",
    "training.position_gain=0.2",
    "training.refresh_fraction=0.5",
    "training.optimisation.num_steps=6",
    "trainer.val_check_interval=2",
    "trainer.enable_progress_bar=false",
    "~callbacks.progress",
    "trainer.log_every_n_steps=1",
    "callbacks.last.every_n_steps=1",
]


def column() -> Scene:
    walls = dict.fromkeys(FACES[2], Wall("friction", 0.385))
    return column_collapse(
        domain=(1.5, 0.75), length=0.375, height=0.5, gravity=9.81, duration=1.0, material=SAND, walls=walls
    )


def plain() -> Corrector:
    """A corrector that corrects nothing."""
    corrector = Corrector(CONFIG).eval()
    corrector.correction_scale.fill_(0)
    return corrector


def off(corrector: Corrector, fine: Trajectory) -> float:
    """How far from that of a fine column the runout of a corrected run is, relative."""
    return runout_error(corrector, fine, corrected_run(corrector, fine, fine.num_frames - 1))


def make_config(root: Path, output: Path, *overrides: str) -> DictConfig:
    """Compose conf/train.yaml as the command does, for a training of a corrector on DATA in `output`."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        cfg = compose("train", TINY)
    more = OmegaConf.from_dotlist([each.lstrip("+") for each in overrides])
    with open_dict(cfg):
        cfg.data = {**DATA, "root": str(root)}
        cfg.model.mpm = dict(COARSE)
        cfg.callbacks.last.directory = cfg.callbacks.best.directory = cfg.logger.csv.save_dir = str(output)
        cfg.merge_with(more)
    return cfg


@pytest.fixture(scope="module")
def fine() -> Trajectory:
    run = run_solver(column(), {**MPM, "cell_size": 1 / 24}, frame_interval=0.02, seed=0)
    thinned: Trajectory = thin_trajectory(run, {**MPM, "cell_size": 1 / 24}, 0, 3, (1, 1))
    return thinned


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set DATA: eight columns to learn from and one that validates."""
    folder = tmp_path_factory.mktemp("data") / "tiny"
    generate_dataset({**DATA, "root": str(folder)}, device="cpu")
    return folder


@pytest.fixture(scope="module")
def whole(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training that nothing has interrupted; nobody writes into it."""
    folder = tmp_path_factory.mktemp("whole")
    assert train(make_config(root, folder), folder, None) == folder / "last.ckpt"
    return folder


def test_without_a_correction_it_is_the_coarse_run(fine: Trajectory) -> None:
    run = corrected_run(plain(), fine, fine.num_frames - 1)
    assert run.num_frames == fine.num_frames
    steps = list(followed_run(fine, plain(), position_gain=0.2))
    np.testing.assert_allclose(run.position[1], steps[0][2], atol=1e-6)
    assert (run.position[-1] - fine.position[-1])[:, 0].min() < -0.1  # it falls short


def test_a_run_that_follows_ends_where_the_fine_one_ends(fine: Trajectory) -> None:
    steps = list(followed_run(fine, plain(), position_gain=0.2))
    assert len(steps) == fine.num_frames - 1
    behind = np.array([np.abs(step[2] - fine.position[k + 1]).mean() for k, step in enumerate(steps)])
    coarse = corrected_run(plain(), fine, fine.num_frames - 1)
    assert behind[-1] < 0.5 * np.abs(coarse.position[-1] - fine.position[-1]).mean()


def test_a_run_led_by_the_network_goes_its_own_way_and_is_told_back(fine: Trajectory) -> None:
    torch.manual_seed(0)
    corrector = Corrector(CONFIG).eval()
    led, own = (make_examples(0, fine, corrector, position_gain=0.2, policy_mix=mix) for mix in (0.0, 1.0))
    position = corrected_run(corrector, fine, 20).position
    np.testing.assert_allclose(own[18].predicted, own[19].position)
    np.testing.assert_allclose(own[19].position, position[19], atol=1e-5)
    wanted = [float(np.square(examples[19].velocity).mean()) for examples in (led, own)]
    assert wanted[1] > 2 * wanted[0]


def test_the_run_leaves_what_any_training_leaves_and_its_corrector(whole: Path) -> None:
    summary, losses = read_summary(whole), [float(row["loss"]) for row in rows(whole) if row["loss"]]
    assert summary is not None and summary["status"] == "finished" and len(losses) == 6
    assert summary["data"] == {
        "name": "tiny",
        "num_train": 3,
        "num_valid": 1,
        "num_windows": summary["data"]["num_windows"],
    }
    errors = [float(row["valid/column_runout_error"]) for row in rows(whole) if row.get("valid/column_runout_error")]
    assert len(errors) == 3 and objective(whole) == summary["best"]["column_runout_error"] == min(errors)
    assert summary["best"]["position_error"] > 0 and summary["checkpoint"] == str(whole / "tiny.corrector")
    assert (whole / "learning_curve.png").is_file()
    file, best = load_corrector(whole / "tiny.corrector"), torch.load(whole / "best.ckpt", weights_only=True)
    assert file.provenance["steps"] == best["global_step"] == summary["best"]["step"]
    assert file.provenance["cost"]["train_seconds"] > 0 and file.data["name"] == "tiny"
    for name, value in file.corrector.state_dict().items():
        assert torch.equal(value, best["state_dict"][f"corrector.{name}"]), name
    with pytest.raises(InputError, match=r"training of a corrector.*take the \.corrector file"):
        load_checkpoint(whole / "best.ckpt")


def test_stopped_and_resumed_it_ends_where_an_uninterrupted_run_does(root: Path, whole: Path, tmp_path: Path) -> None:
    """Weights, average, optimiser, schedule, progress, and which examples were renewed with which weights."""
    with pytest.raises(SystemExit, match="stopped after 5 steps; to go on, add resume="):
        cut = make_config(root, tmp_path, *callback("SignalAt", step=4, number=int(signal.SIGTERM)))
        train(cut, tmp_path, None)
    assert load_corrector(tmp_path / "tiny.corrector").provenance["steps"] in (2, 4)
    train(make_config(root, tmp_path), tmp_path, find_resume("auto", tmp_path))
    for name in ("last.ckpt", "best.ckpt"):
        assert_same(*(torch.load(folder / name, weights_only=True) for folder in (whole, tmp_path)))
    renewed = torch.load(tmp_path / "last.ckpt", weights_only=True)["FollowedRuns"]
    assert renewed["renewed"] and {made for made, _ in renewed["renewed"].values()} == set(renewed["weights"])


def test_a_run_killed_behind_its_last_step_still_gets_its_corrector(
    root: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("last.ckpt", "best.ckpt"):
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    monkeypatch.setattr("gns_pl.training.train.build_trainer", lambda *_: pytest.fail("nothing is left to do"))
    train(make_config(root, tmp_path), tmp_path, tmp_path / "last.ckpt")
    expected, corrector = (load_corrector(folder / "tiny.corrector").corrector for folder in (whole, tmp_path))
    assert_same(expected.state_dict(), corrector.state_dict())


def test_fitting_finds_what_a_coarse_run_misses(root: Path, fine: Trajectory, tmp_path: Path) -> None:
    changes = [
        "training.optimisation.num_steps=300",
        "trainer.val_check_interval=100",
        "callbacks.last.every_n_steps=100",
    ]
    changes += ["training.num_train=null"]
    train(make_config(root, tmp_path, *changes), tmp_path, None)
    path = tmp_path / "tiny.corrector"
    corrector, static = load_corrector(path).corrector, static_of(fine)
    missed = wanted = 0.0
    for _, before, position, predicted, velocity in make_examples(0, fine, corrector, position_gain=0.2):
        learned = corrector(*map(torch.from_numpy, (before, position, predicted)), static).detach().numpy()
        missed, wanted = missed + np.square(velocity - learned).sum(), wanted + np.square(velocity).sum()
    assert missed < 0.8 * wanted  # on a column it was not fitted to
    assert off(plain(), fine) > 0.1 and math.isfinite(off(corrector, fine))
    solver = CorrectedSolver("tiny", path)
    assert solver.unsupported_reason(column()) is None
    run = solver.run(column(), interval=0.01, seed=1)
    assert run.num_frames == 101 and solver.size(column())[1] == 50


def test_scales_are_root_mean_squares() -> None:
    corrector = Corrector(CONFIG)
    still, there, wanted = np.zeros((4, 2), np.float32), np.full((4, 2), 0.03, np.float32), np.ones((4, 2), np.float32)
    fit_scales(corrector, [Example(0, still, still, there, 3 * wanted), Example(0, still, still, still, wanted)])
    assert float(corrector.velocity_scale) == pytest.approx(0.03 / 0.02 / math.sqrt(2))
    assert float(corrector.correction_scale) == pytest.approx(math.sqrt(5))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("training.refresh_fraction=2", "refresh_fraction must be at most 1"),
        ("training.batch_size=0", "batch_size must be a whole number of at least 1"),
        ("training.catch_up=0.1", "unknown key catch_up; known are .*position_gain"),
        ("model.slow=0.1", "model: unknown key slow; known are .*velocity_threshold"),
        ("model.velocity_threshold=0", r"model\.velocity_threshold must be positive"),
        ("model.mpm.cells=1", "cells"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_generated(tmp_path: Path, change: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        train(make_config(tmp_path / "data", tmp_path / "run", change), tmp_path / "run", None)
    assert not (tmp_path / "data").exists() and not (tmp_path / "run").exists()


def test_other_settings_devices_and_advice_are_refused(root: Path, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"was made with training\.position_gain=0\.2, not 0\.3"):
        train(make_config(root, whole, "training.position_gain=0.3"), whole, whole / "last.ckpt")
    with pytest.raises(InputError, match=r"by one process on a CPU: trainer\.accelerator=cpu trainer\.devices=1"):
        train(make_config(root, tmp_path, "trainer.devices=2"), tmp_path, None)
    with pytest.raises(InputError, match="no advice for a corrector"):
        advise(make_config(root, tmp_path), tmp_path)


def test_imported_data_and_data_without_a_column_to_judge_by_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error of nothing would be the least there is."""
    flight = sets.make_flight(sets.make_scene(), 3)
    sets.write_set(tmp_path / "set", [flight, flight], valid=1)
    imported = make_config(tmp_path / "set", tmp_path / "run")
    with open_dict(imported):
        imported.data = {"name": "a", "imported": {}, "gravity": 9.81, "families": {}, "root": str(tmp_path / "set")}
    with pytest.raises(InputError, match="these data are imported"):
        train(imported, tmp_path / "run", None)
    monkeypatch.setattr("gns_pl.training.train.find_dataset", lambda *_, **__: tmp_path / "set")
    with pytest.raises(InputError, match="no validation trajectory runs out"):
        train(make_config(tmp_path, tmp_path / "run", "training.num_train=null"), tmp_path / "run", None)
    assert not list((tmp_path / "run").glob("*.c*"))
