"""A tiny dataset made by the real solver, once per session, and configs that train on it in seconds."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf, open_dict

from gns_pl.training.train import train

FAMILIES = {
    "cube_drop": {
        "count": 3,
        "valid": 1,
        "test": 0,
        "duration": 0.2,
        "domain": [1.0, 1.0, 1.0],
        "side": [0.25, 0.3],
        "speed": 1.0,
        "max_drop": 0.1,
    }
}
CONF = Path(__file__).parents[2] / "conf"

TINY = [
    "+experiment=quickstart",
    "data.frame_interval=0.02",
    "data.mpm.cell_size=0.125",
    "model.connectivity_radius=0.11",
    "model.input_sequence_length=4",
    "training.moving_repeats=1",
    "model.latent_size=8",
    "model.num_message_passing_steps=1",
    "training.optimisation.num_steps=6",
    "training.optimisation.warmup_steps=2",
    "training.rollout.num_steps=0",
    "callbacks.best.monitor=valid/position_error",
    "trainer.val_check_interval=3",
    "trainer.enable_progress_bar=false",
    "~callbacks.progress",
    "trainer.log_every_n_steps=1",
    "callbacks.last.every_n_steps=2",
]


@pytest.fixture(scope="session")
def data_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "tiny"


WHOLE = {
    "distribution.WINDOWS": ("tests.training.test_distribution",),
    "run_summary.plot_learning_curve": ("tests.training.test_run_summary", "tests.training.test_correction"),
}
"""What takes most of the time of trainings so small, and the modules in which it is what a training has."""


def shorten(patch: pytest.MonkeyPatch, module: str = "") -> None:
    """Look at fewer windows for what a network saw, and leave the learning curve empty, where they are not tested."""
    stand_ins = (20, lambda training, validation, path, *, title: path.touch())
    for (place, modules), stand_in in zip(WHOLE.items(), stand_ins, strict=True):
        if module not in modules:
            patch.setattr(f"gns_pl.training.{place}", stand_in)


@pytest.fixture(autouse=True, scope="module")
def _short_trainings(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, request.module.__name__)
        yield


@pytest.fixture(scope="session")
def whole_run(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of TINY that nothing has interrupted; nobody writes into it."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch)
        train(make_config(data_root, folder), folder, None)
    return folder


def make_config(data_root: Path, output: Path, *overrides: str) -> DictConfig:
    """Compose conf/train.yaml as the command does, for a run in `output`, without W&B."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        cfg = compose("train", [*TINY, f"data.root={data_root}", *without_wandb(overrides), *overrides])
    with open_dict(cfg):
        cfg.data.families = FAMILIES
        cfg.callbacks.last.directory = str(output)
        cfg.callbacks.best.directory = str(output)
        if "csv" in cfg.get("logger", {}):
            cfg.logger.csv.save_dir = str(output)
    assert OmegaConf.missing_keys(cfg) == set()
    return cfg


def without_wandb(overrides: Sequence[str]) -> list[str]:
    """Return the override that leaves W&B out, unless others say what logs."""
    return [] if any(each.split("=")[0] in ("logger", "~logger") for each in overrides) else ["logger=csv"]


def rows(output: Path) -> list[dict[str, str]]:
    """Read the CSV log of a run's only start."""
    with next((output / "csv").glob("*/metrics.csv")).open() as file:
        return list(csv.DictReader(file))


DIFFERENT = {"provenance", "Timer", "Clock"}
"""Entries of a checkpoint that two equal runs do not share: when and where they were made."""


def assert_same(one: Any, two: Any, place: str = "") -> None:
    """Compare two checkpoints to the last bit: weights, average, optimiser, schedule, loops, callbacks."""
    if isinstance(one, dict):
        keys = [set(each) - DIFFERENT for each in (one, two)]
        assert keys[0] == keys[1], place
        for key in keys[0]:
            assert_same(one[key], two[key], f"{place}/{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(two), place
        for index, pair in enumerate(zip(one, two, strict=True)):
            assert_same(*pair, f"{place}/{index}")
    elif isinstance(one, torch.Tensor):
        assert torch.equal(one, two), place
    else:
        assert one == two, place
