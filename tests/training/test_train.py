"""Training as a whole: it learns, its checkpoint rebuilds itself, and a resumed run ends where a whole one does."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gns_pl.training.loggers import make_loggers
from gns_pl.training.module import learning_rate_factor
from gns_pl.training.resume import find_resume
from gns_pl.training.train import train
from tests.conftest import make_simulator
from tests.training.conftest import make_config, rows


def weights(path: Path) -> dict[str, torch.Tensor]:
    content = torch.load(path, weights_only=True)
    assert content["global_step"] == 6
    state: dict[str, torch.Tensor] = content["current_model_state"] | {
        f"average.{name}": value for name, value in content["state_dict"].items()
    }
    return state


@pytest.fixture(scope="module")
def begun(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The last checkpoint of a training of TINY that was stopped after two of its steps."""
    folder = tmp_path_factory.mktemp("begun")
    return train(make_config(data_root, folder, "trainer.max_steps=2"), folder, None)


def test_a_resumed_run_equals_an_uninterrupted_one(data_root: Path, whole_run: Path, tmp_path: Path) -> None:
    cut = make_config(data_root, tmp_path / "cut", "trainer.max_steps=4")
    train(cut, tmp_path / "cut", None)
    resumed = make_config(data_root, tmp_path / "cut")
    train(resumed, tmp_path / "cut", find_resume("auto", tmp_path / "cut"))
    expected, got = weights(whole_run / "last.ckpt"), weights(tmp_path / "cut" / "last.ckpt")
    assert expected.keys() == got.keys()
    for name, value in expected.items():
        assert torch.equal(value, got[name]), name


def test_the_run_leaves_what_it_promises(data_root: Path, tmp_path: Path) -> None:
    last = train(make_config(data_root, tmp_path, "description=a test"), tmp_path, None)
    assert last == tmp_path / "last.ckpt" and (tmp_path / "best.ckpt").is_file()
    checkpoint = load_checkpoint(last)
    assert checkpoint.data["families"]["cube_drop"]["count"] == 3
    assert checkpoint.provenance["description"] == "a test" and checkpoint.provenance["steps"] == 6
    assert checkpoint.provenance["config"]["model"]["latent_size"] == 8
    assert len(checkpoint.provenance["manifest_sha256"]) == 64
    cost = checkpoint.provenance["cost"]
    assert cost["data_seconds"] > 0 and cost["train_seconds"] > 0 and cost["num_threads"] >= 1
    losses = [float(row["loss"]) for row in rows(tmp_path) if row["loss"]]
    errors = [float(row["valid/position_error"]) for row in rows(tmp_path) if row.get("valid/position_error")]
    assert len(losses) >= 3 and all(math.isfinite(value) for value in losses)
    assert len(errors) == 2


def test_it_learns(data_root: Path, tmp_path: Path) -> None:
    """Without noise a small network fits three short trajectories well below the loss of predicting nothing."""
    changes = ["training.optimisation.num_steps=150", "training.optimisation.warmup_steps=5", "training.noise_std=0.0"]
    changes += ["training.strain_std=0.0", "training.optimisation.huber_delta=null", "callbacks.average.decay=0.9"]
    changes += ["model.latent_size=16", "trainer.val_check_interval=150"]
    train(make_config(data_root, tmp_path, *changes), tmp_path, None)
    losses = [float(row["loss"]) for row in rows(tmp_path) if row["loss"]]
    assert sum(losses[-30:]) / 30 < 0.35 * sum(losses[:5]) / 5


def test_longer_steps(data_root: Path, tmp_path: Path) -> None:
    """With a stride of two the simulator's step is twice the data's, and so are its windows and its validation."""
    cfg = make_config(data_root, tmp_path, "training.stride=2", "training.optimisation.unroll_steps=2")
    simulator = load_checkpoint(train(cfg, tmp_path, None)).simulator
    assert simulator.config.dt == pytest.approx(0.04)
    velocity, count = 0.0, 0
    for path in sorted(data_root.glob("*.h5")):
        if path.name in read_manifest(data_root).splits["train"]:
            moved = np.diff(read_trajectory(path).position[::2].astype(float), axis=0) / 0.04
            start = read_trajectory(path).initial_velocity[None]
            velocity += float(np.square(np.concatenate([start, moved])).sum())
            count += moved.size + start.size
    noise = cfg.training.noise_std / 0.04
    assert float(simulator.velocity_scale) == pytest.approx(math.sqrt(velocity / count + noise**2), rel=1e-5)


def test_resuming_with_other_settings_is_refused(data_root: Path, begun: Path) -> None:
    before = begun.read_bytes()
    other = make_config(data_root, begun.parent, "model.latent_size=4")
    with pytest.raises(InputError, match=r"was made with model\.latent_size=8, not 4"):
        train(other, begun.parent, begun)
    assert begun.read_bytes() == before


@pytest.mark.parametrize("change", ["training.batch_size=3", "callbacks.average.decay=0.5", "seed=1"])
def test_whatever_decides_the_end_is_compared(data_root: Path, begun: Path, change: str) -> None:
    with pytest.raises(InputError, match=change.split("=")[0]):
        train(make_config(data_root, begun.parent, change), begun.parent, begun)


def test_a_finished_run_is_left_as_it_is(data_root: Path, tmp_path: Path) -> None:
    last = train(make_config(data_root, tmp_path), tmp_path, None)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert train(make_config(data_root, tmp_path), tmp_path, last) == last
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_checkpoint_that_cannot_be_resumed(data_root: Path, tmp_path: Path) -> None:
    damaged, stepless = tmp_path / "damaged.ckpt", tmp_path / "stepless.ckpt"
    damaged.write_bytes(b"not a checkpoint")
    save_checkpoint(stepless, Checkpoint(make_simulator(), {}, {}))
    for path, sentence in ((damaged, "not a readable checkpoint"), (stepless, "no state of a training")):
        with pytest.raises(InputError, match=sentence):
            train(make_config(data_root, tmp_path), tmp_path, path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("training.batch_size=0", "batch_size must be a whole number of at least 1"),
        ("training.noise_std=abc", "noise_std must be a number"),
        ("+training.noise_sdt=1", "unknown key noise_sdt"),
        ("training.optimisation.huber_delta=-1", "huber_delta"),
        ("training.optimisation.column_weight=-1", "column_weight"),
        ("model.output=magic", "output must be one of"),
        ("callbacks.last.keep=0", "keep must be a whole number of at least 1"),
        ("trainer.max_time=tomorrow", "not a valid duration"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_generated(tmp_path: Path, change: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        train(make_config(tmp_path / "data", tmp_path, change), tmp_path, None)
    assert not (tmp_path / "data").exists()


def test_windows_that_devices_cannot_share_are_refused_before_anything_is_generated(tmp_path: Path) -> None:
    cfg = make_config(tmp_path / "data", tmp_path, "trainer.devices=3", "trainer.accelerator=cpu")
    with pytest.raises(InputError, match="batch_size=2 windows per step cannot be shared by 3 processes"):
        train(cfg, tmp_path, None)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(("wanted", "number"), [("null", 1), ("[]", 0), ("[tan_friction_angle]", 1)])
def test_material_features_are_optional_inputs(data_root: Path, tmp_path: Path, wanted: str, number: int) -> None:
    cfg = make_config(data_root, tmp_path, f"model.material_features={wanted}", "training.optimisation.num_steps=2")
    simulator = load_checkpoint(train(cfg, tmp_path, None)).simulator
    assert len(simulator.config.material_features) == number
    without = 3 * 3 + 2 * 3 + 7  # velocities, walls, context
    assert simulator.network.node_encoder[0].in_features == without + number


def test_material_features_the_data_do_not_have(data_root: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the data have"):
        train(make_config(data_root, tmp_path, "model.material_features=[cohesion]"), tmp_path, None)


@pytest.mark.parametrize(("choice", "spacing"), [((), 0.125), (("+data.every=1",), 0.0625)])
def test_one_of_the_stored_lattices_is_trained_on(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, choice: tuple[str, ...], spacing: float
) -> None:
    data_root = tmp_path_factory.getbasetemp() / "thinned"  # made once for both
    cfg = make_config(data_root, tmp_path, "+data.store_every=[2,1]", "model.connectivity_radius=0.22", *choice)
    checkpoint = load_checkpoint(train(cfg, tmp_path, None))
    assert checkpoint.simulator.config.spacing == spacing
    assert checkpoint.data["store_every"] == [2, 1]
    assert (data_root / "every_2" / "manifest.json").is_file() and (data_root / "every_1" / "manifest.json").is_file()


def test_a_lattice_that_is_not_stored_is_refused_before_anything_is_generated(tmp_path: Path) -> None:
    cfg = make_config(tmp_path / "data", tmp_path, "+data.store_every=[2,4]", "+data.every=3")
    with pytest.raises(InputError, match="every is 3, but the set is stored with every 2 or 4"):
        train(cfg, tmp_path, None)
    assert not (tmp_path / "data").exists()


def test_more_trajectories_than_there_are(data_root: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="2 training trajectories"):
        train(make_config(data_root, tmp_path, "training.num_train=5"), tmp_path, None)


def test_find_resume(tmp_path: Path) -> None:
    assert find_resume(None, tmp_path) is None
    assert find_resume("auto", tmp_path) is None
    (tmp_path / "last.ckpt").touch()
    assert find_resume("auto", tmp_path) == tmp_path / "last.ckpt"
    with pytest.raises(InputError, match="no such checkpoint"):
        find_resume(str(tmp_path / "other.ckpt"), tmp_path)


def test_learning_rate() -> None:
    settings = {"warmup_steps": 10, "num_steps": 110, "final_factor": 0.1}
    assert learning_rate_factor(0, **settings) == pytest.approx(0.1)
    assert learning_rate_factor(9, **settings) == learning_rate_factor(10, **settings) == 1.0
    assert learning_rate_factor(60, **settings) == pytest.approx(0.55)
    assert learning_rate_factor(110, **settings) == learning_rate_factor(500, **settings) == pytest.approx(0.1)


def test_statistics_are_root_mean_squares_with_gravity_and_noise() -> None:
    moments = {
        "velocity": {"mean": [3.0, 0.0], "std": [0.0, 4.0]},
        "acceleration": {"mean": [0.0, -10.0], "std": [1.0, 0.0]},
    }
    simulator, material = make_simulator(dim=2, dt=0.1), torch.tensor([[0.5], [0.1]])
    for noise, velocity, acceleration in ((0.0, 12.5, 1.0), (0.2, 12.5 + 4, 1 + 400)):
        simulator.fit_statistics(moments, gravity=9.0, noise_std=noise, material=material)
        assert float(simulator.velocity_scale) == pytest.approx(math.sqrt(velocity))
        assert float(simulator.acceleration_scale) == pytest.approx(math.sqrt(acceleration))
        assert torch.equal(simulator.material_scale, material)


@pytest.mark.parametrize(("mode", "offline"), [(None, True), ("offline", True), ("dryrun", True), ("disabled", None)])
def test_wandb_does_as_its_variable_says(
    mode: str | None, offline: bool | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("WANDB_MODE", raising=False)
    if mode is not None:
        monkeypatch.setenv("WANDB_MODE", mode)
    settings = {
        "offline": mode is None,
        "csv": {"_target_": "lightning.pytorch.loggers.CSVLogger", "save_dir": str(tmp_path)},
        "wandb": {
            "_target_": "lightning.pytorch.loggers.WandbLogger",
            "save_dir": str(tmp_path),
            "offline": "${offline}",
        },
    }
    loggers = make_loggers(OmegaConf.create(settings))
    assert [type(logger).__name__ for logger in loggers] == ["CSVLogger", "WandbLogger"][: 1 if offline is None else 2]
    if offline is not None:
        assert loggers[1]._offline is offline  # type: ignore[attr-defined]


def test_a_radius_without_neighbours_is_refused_before_the_first_step(data_root: Path, tmp_path: Path) -> None:
    """As with the default radius in a field of 100 m; said with the spacing and what to set, and nothing is left."""
    with pytest.raises(InputError, match=r"has 0 neighbours .*= 0\.001 m, .* take model\.connectivity_radius=0\.\d+$"):
        train(make_config(data_root, tmp_path, "model.connectivity_radius=0.001"), tmp_path, None)
    assert not list(tmp_path.rglob("*.ckpt"))
