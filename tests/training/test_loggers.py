"""The groups of conf/logger: what each one logs to, and what W&B is given."""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from lightning.pytorch.loggers import CSVLogger
from omegaconf import DictConfig, OmegaConf, open_dict
from PIL import Image

from gns_pl.errors import InputError
from gns_pl.io.tracking import started, unless_disabled
from gns_pl.training import loggers
from gns_pl.training.loggers import TensorBoard, WandbRun, make_loggers
from tests.training.conftest import CONF


def group(folder: Path, *overrides: str) -> DictConfig | None:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        cfg = compose("train", [*overrides])
    if "logger" not in cfg:
        return None
    for each in cfg.logger.values():
        if OmegaConf.is_dict(each):
            with open_dict(each):
                each.save_dir = str(folder)
                each.update({key: "given" for key in ("name", "group") if key in each})
    return cfg.logger


def test_wandb_has_what_is_set_and_nothing_that_it_warns_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WANDB_MODE", raising=False)
    cfg = group(
        tmp_path, "logger.entity=lab", "logger.tags=[small,columns]", "logger.notes=a try", "logger.project=sand"
    )
    beside, run = make_loggers(cfg)
    assert isinstance(beside, CSVLogger) and isinstance(run, WandbRun)
    given = run._wandb_init
    assert {key: given[key] for key in ("entity", "project", "notes", "job_type")} == {
        "entity": "lab", "project": "sand", "notes": "a try", "job_type": "training",
    }  # fmt: skip
    assert list(given["tags"]) == ["small", "columns"] and run._offline
    assert "anonymous" not in given


def test_a_run_of_wandb_starts_without_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("WANDB_MODE", "offline")
    run = make_loggers(group(tmp_path, "logger.tags=[small]"))[1]
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        started = run.experiment
    loggers.close_loggers([run])
    assert tuple(started.tags) == ("small",)
    captured = capfd.readouterr()
    assert "anonymous" not in captured.err + captured.out


@pytest.mark.parametrize("name", ["one", "two"])
def test_runs_are_written_where_they_are_asked_for_from_any_working_directory(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """W&B's own process stays in the directory in which the first run was started: the second shows what that costs."""
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.chdir(tmp_path)
    log = unless_disabled(log_nothing)
    (folder,) = log(Path("out"))
    run = make_loggers(group(Path("run")))[1]
    assert run.experiment
    loggers.close_loggers([run])
    deadline = time.monotonic() + 20
    while len(found := list(tmp_path.glob("*/wandb/offline-run-*/run-*.wandb"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert sorted(path.relative_to(tmp_path).parts[0] for path in found) == ["out", "run"]
    assert folder.parts[0] == "out" and list(folder.glob("run-*.wandb"))


def log_nothing(out: Path) -> Path:
    with started("nothing", {}, out=out, offline=True, project="sand") as run:
        return Path(run.dir).parent


@pytest.mark.parametrize(("override", "kinds"), [("logger=csv", [CSVLogger]), ("logger=none", []), ("~logger", [])])
def test_other_groups(tmp_path: Path, override: str, kinds: list[type]) -> None:
    assert [type(each) for each in make_loggers(group(tmp_path, override))] == kinds


def test_tensorboard_is_an_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loggers, "find_spec", lambda name: None)
    with pytest.raises(
        Exception, match=r"logger=tensorboard needs the package tensorboard \(pip install 'gns_pl\["
    ) as e:
        make_loggers(group(tmp_path, "logger=tensorboard"))
    assert isinstance(e.value.__cause__, InputError)  # `build_trainer` tells it


def test_tensorboard_gets_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Writer:
        images: Any = None

        def add_image(self, key: str, image: Any, step: int, dataformats: str) -> None:
            self.images = (key, image, step, dataformats)

    writer, path = Writer(), tmp_path / "a.png"
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    Image.fromarray(pixels).save(path)
    monkeypatch.setattr(loggers, "find_spec", lambda name: name)
    monkeypatch.setattr(loggers.TensorBoardLogger, "__init__", lambda self, **_: None)
    monkeypatch.setattr(TensorBoard, "experiment", writer)
    TensorBoard().log_image("curve", [str(path)], step=7)
    key, image, step, dataformats = writer.images
    assert (key, step, dataformats) == ("curve", 7, "HWC") and (image == pixels).all()
