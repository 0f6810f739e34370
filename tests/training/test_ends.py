"""However a fit ends, all its steps are saved; what cannot be validated is told before the first step."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.pytorch import Callback, LightningModule, Trainer
from omegaconf import DictConfig, open_dict

from gns_pl.commands import train as train_command
from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory, write_manifest, write_trajectory
from gns_pl.training import rollout_figure, run_summary
from gns_pl.training.summary import objective, read_summary
from gns_pl.training.train import train
from gns_pl.trajectory import Trajectory
from tests.training.conftest import FAMILIES, assert_same, make_config
from tests.training.test_stopping import callback

HERE = "tests.training.test_ends"
ONLY_AT_END = ("callbacks.last.every_n_steps=500",)


@pytest.fixture(scope="module")
def folder(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny data set as a folder that was made elsewhere: two trajectories, one of them held out twice as file."""
    from gns_pl.generation import generate_dataset

    made = generate_dataset(make_config_data(data_root), progress=False)
    target = tmp_path_factory.mktemp("imported") / "set"
    shutil.copytree(made, target)
    edit(target, spec={"name": "theirs", "imported": {"format": "made up"}, "gravity": 9.81})
    return target


def make_config_data(data_root: Path) -> dict[str, Any]:
    from omegaconf import OmegaConf

    plain: Any = OmegaConf.to_container(make_config(data_root, data_root).data, resolve=True)
    return {**plain, "families": FAMILIES}


def edit(target: Path, **changes: Any) -> None:
    write_manifest(target, replace(read_manifest(target), **changes))


def copied(folder: Path, tmp_path: Path, **changes: Any) -> Path:
    target = tmp_path / "set"
    shutil.copytree(folder, target)
    edit(target, **changes)
    return target


def imported(root: Path, output: Path, *overrides: str) -> DictConfig:
    cfg = make_config(root, output, *overrides)
    with open_dict(cfg):
        cfg.data = {"name": "imported", "root": str(root)}
    return cfg


def steps(path: Path) -> int:
    return int(torch.load(path, weights_only=True)["global_step"])


def without_validation(folder: Path, tmp_path: Path) -> Path:
    """Training and test only."""
    splits = read_manifest(folder).splits
    return copied(folder, tmp_path, splits={"train": splits["train"], "valid": (), "test": splits["valid"]})


def test_nothing_to_validate_on(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, output = without_validation(folder, tmp_path), tmp_path / "run"
    last = train(imported(root, output, *ONLY_AT_END), output, None)
    assert steps(last) == 6 and not (output / "best.ckpt").exists()
    summary = read_summary(output)
    assert summary is not None and summary["checkpoint"] == str(last) and summary["best"] is None
    assert summary["data"]["num_valid"] == 0 and objective(output) is None
    captured = capsys.readouterr()
    assert "no best.ckpt; the result is last.ckpt" in captured.out and "best.ckpt\n" not in captured.out


@pytest.mark.parametrize(("override", "made"), [
    ("trainer.limit_val_batches=0", 6), ("trainer.val_check_interval=null", 6), ("+trainer.limit_train_batches=5", 5),
])  # fmt: skip
def test_every_way_a_fit_ends(data_root: Path, tmp_path: Path, override: str, made: int) -> None:
    """Also without a bar, whose callback Lightning refuses then."""
    cfg = make_config(data_root, tmp_path, *ONLY_AT_END, override, "trainer.enable_progress_bar=false")
    with open_dict(cfg):  # as the command has it
        cfg.callbacks.progress = {"_target_": "gns_pl.training.progress.TrainingProgress", "title": "a"}
    assert steps(train(cfg, tmp_path, None)) == made
    assert (tmp_path / "best.ckpt").exists() == (override != "trainer.limit_val_batches=0")


def test_a_best_checkpoint_of_another_run_is_not_this_runs(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "best.ckpt").write_bytes(b"of an older run")
    train(make_config(data_root, tmp_path, "trainer.limit_val_batches=0"), tmp_path, None)
    summary = read_summary(tmp_path)
    assert summary is not None and summary["checkpoint"] == str(tmp_path / "last.ckpt")
    assert "best.ckpt\n" not in capsys.readouterr().out
    assert (tmp_path / "best.ckpt").read_bytes() == b"of an older run"


class RaiseAt(Callback):
    """Raises in a step, before or after the weights are changed, or in a validation."""

    def __init__(self, step: int, where: str) -> None:
        self.step, self.where = step, where

    def _raise(self, trainer: Trainer, where: str) -> None:
        if self.where == where and trainer.global_step == self.step:
            raise RuntimeError("the device is gone")

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        self._raise(trainer, "start")

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        self._raise(trainer, "end")

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        self._raise(trainer, "validation")


@pytest.fixture(scope="module")
def saved_at_its_end(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training that nothing has interrupted, whose checkpoints are of its validations and its end."""
    folder = tmp_path_factory.mktemp("saved_at_its_end")
    train(make_config(data_root, folder, *ONLY_AT_END), folder, None)
    return folder


@pytest.mark.parametrize(("where", "step", "saved"), [
    ("start", 5, 5), ("end", 6, 3), ("validation", 6, 6),
])  # fmt: skip
def test_an_error_does_not_cost_the_steps_before_it(
    data_root: Path, saved_at_its_end: Path, tmp_path: Path, where: str, step: int, saved: int
) -> None:
    """Weights that a step has changed in part are not saved; what is, goes on as if nothing had been."""
    cut = tmp_path / "cut"
    cfg = make_config(data_root, cut, *ONLY_AT_END, *callback("RaiseAt", step=step, where=where))
    with open_dict(cfg):
        cfg.callbacks.extra._target_ = f"{HERE}.RaiseAt"
    with pytest.raises(RuntimeError, match="the device is gone") as caught:
        train(cfg, cut, None)
    assert steps(cut / "last.ckpt") == saved
    assert any("add resume=" in note for note in caught.value.__notes__)
    if where != "validation":
        train(make_config(data_root, cut, *ONLY_AT_END), cut, cut / "last.ckpt")
        for name in ("last.ckpt", "best.ckpt"):
            contents = [torch.load(each / name, weights_only=True) for each in (saved_at_its_end, cut)]
            for content in contents:
                del content["loops"]  # they count the step that was begun twice
            assert_same(*contents)


def test_figures_and_reports_cost_no_result(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*args: Any, **kwargs: Any) -> None:
        raise RuntimeError("no fonts\nat all")

    monkeypatch.setattr(rollout_figure, "draw_rollout", broken)
    monkeypatch.setattr(run_summary, "plot_learning_curve", broken)
    monkeypatch.setattr(run_summary, "summary_lines", broken)
    cfg = make_config(data_root, tmp_path)
    with open_dict(cfg):
        cfg.logger.fake = {"_target_": "tests.training.fake_logger.FakeLogger"}
    assert steps(train(cfg, tmp_path, None)) == 6
    told = capsys.readouterr().err
    assert "summary.json could not be made (RuntimeError: no fonts)" in told
    assert "learning_curve.png could not be made (RuntimeError: no fonts); the results are there without." in told
    assert told.count("the figures of a validation rollout could not be made") == 2 and "Traceback" not in told
    assert read_summary(tmp_path) is not None


def test_no_gravity(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Errors have their values, but none in the time of a collapse; the figures that need it are left out."""
    root, output = copied(folder, tmp_path), tmp_path / "run"
    for name in read_manifest(root).files:
        flow = read_trajectory(root / name)
        write_trajectory(root / name, replace(flow, scene=replace(flow.scene, gravity=(0.0, 0.0, 0.0))))
    edit(root, spec={"name": "theirs", "imported": {}, "gravity": 0.0})
    cfg = imported(root, output)
    with open_dict(cfg):
        cfg.logger.fake = {"_target_": "tests.training.fake_logger.FakeLogger"}
    assert steps(train(cfg, output, None)) == 6
    summary = read_summary(output)
    assert summary is not None and summary["final"]["position_error"] > 0 and "arrest_time" not in summary["final"]
    assert objective(output) == summary["best"]["position_error"]
    assert "has no gravity" in capsys.readouterr().err


def shortened(root: Path, name: str, frames: int) -> None:
    flow: Trajectory = read_trajectory(root / name)
    write_trajectory(root / name, replace(flow, position=flow.position[:frames]))
    manifest = read_manifest(root)
    edit(root, files={**manifest.files, name: replace(manifest.files[name], num_frames=frames)})


@pytest.mark.parametrize(("frames", "stride"), [(1, 1), (2, 2)])
def test_a_validation_without_a_step_is_refused(folder: Path, tmp_path: Path, frames: int, stride: int) -> None:
    root = copied(folder, tmp_path)
    [name] = read_manifest(root).splits["valid"]
    shortened(root, name, frames)
    cfg = imported(root, tmp_path, f"training.stride={stride}")
    with pytest.raises(InputError, match=rf"no validation trajectory has the {stride + 1} frames of a step"):
        train(cfg, tmp_path, None)
    assert not list(tmp_path.glob("*.ckpt"))


def test_short_validations_are_left_out(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = copied(folder, tmp_path)
    manifest = read_manifest(root)
    [valid], short = manifest.splits["valid"], "short.h5"
    shutil.copyfile(root / valid, root / short)
    edit(
        root,
        files={**manifest.files, short: manifest.files[valid]},
        splits={**manifest.splits, "valid": (short, valid)},
    )
    shortened(root, short, 1)
    alone, both = tmp_path / "alone", tmp_path / "both"
    train(imported(folder, alone), alone, None)
    train(imported(root, both), both, None)
    assert "1 of 2 validation trajectories have fewer than the 2 frames of a step and are left out: short.h5" in (
        capsys.readouterr().out
    )
    assert objective(alone) == objective(both) is not None


@pytest.mark.parametrize(("split", "damage"), [("valid", "missing"), ("valid", "cut"), ("train", "missing")])
def test_a_file_that_cannot_be_read_is_told_before_the_first_step(
    folder: Path, tmp_path: Path, split: str, damage: str
) -> None:
    root = copied(folder, tmp_path)
    name = read_manifest(root).splits[split][0]
    if damage == "missing":
        (root / name).unlink()
    else:
        (root / name).write_bytes((root / name).read_bytes()[:2000])
    with pytest.raises(InputError, match=name):
        train(imported(root, tmp_path), tmp_path, None)
    assert not list(tmp_path.glob("*.ckpt")) and not (tmp_path / "summary.json").exists()


def test_a_folder_that_cannot_be_written_is_told(data_root: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    output = tmp_path / "file/run"
    with pytest.raises(InputError, match=r"file/run: cannot be written \(Not a directory\)"):
        train(make_config(data_root, output), output, None)


def test_a_training_begins_without_warnings(data_root: Path, tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    """Of the standard deviation of nothing, say, which torch warns of."""
    train(make_config(data_root, tmp_path, "model.material_features=[]"), tmp_path, None)
    assert not [str(each.message) for each in recwarn if issubclass(each.category, UserWarning)]


@pytest.mark.parametrize("overrides", [["logger=none"], ["~logger"], ["logger=csv"]])
def test_without_a_tracker(data_root: Path, tmp_path: Path, overrides: list[str]) -> None:
    train(make_config(data_root, tmp_path, *overrides), tmp_path, None)
    summary = read_summary(tmp_path)
    assert summary is not None and summary["final"]["step"] == 6 and summary["best"]["step"] in (3, 6)
    best = torch.load(tmp_path / "best.ckpt", weights_only=True)
    assert objective(tmp_path) == pytest.approx(best["callbacks"]["BestCheckpoint"]["least"], rel=1e-6)
    assert (tmp_path / "csv").is_dir() == (tmp_path / "learning_curve.png").is_file() == (overrides == ["logger=csv"])


def test_the_command_returns_what_a_sweeper_makes_small(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a value Optuna finds no trial completed."""
    hydra = SimpleNamespace(mode=RunMode.RUN, runtime=SimpleNamespace(output_dir=str(tmp_path)))
    monkeypatch.setattr(HydraConfig, "get", lambda: hydra)
    error = train_command.main.__wrapped__(make_config(data_root, tmp_path))
    summary = read_summary(tmp_path)
    assert summary is not None and error == summary["best"]["position_error"] > 0
    summary["best"] = None  # all rollouts failed
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    assert objective(tmp_path) == math.inf
