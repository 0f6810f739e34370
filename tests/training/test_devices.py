"""Two processes that share a batch end where one with the whole batch does; without averaging they would not."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.strategies import DDPStrategy
from omegaconf import DictConfig

from gns_pl.errors import InputError
from gns_pl.training.devices import check_devices
from gns_pl.training.train import train
from tests.conftest import free_port, start_processes
from tests.training.conftest import make_config, rows

HERE = "tests.training.test_devices"
BATCH = ["training.batch_size=4", "training.rollout.num_steps=2", "trainer.accelerator=cpu"]


class KeepRank(Callback):
    """Saves the weights that every process ends with, and how many particles it saw in every step."""

    def __init__(self, directory: str) -> None:
        self.directory = Path(directory)
        self.particles: list[int] = []

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        self.particles.append(batch.num_nodes)
        if trainer.global_step == trainer.max_steps:
            content = {"weights": pl_module.state_dict(), "particles": self.particles}
            torch.save(content, self.directory / f"rank{trainer.global_rank}.pt")


class Unaveraged(DDPStrategy):
    """What training looks like when the gradients of the processes are left alone."""

    def _setup_model(self, model: Any) -> Any:
        def own(state, bucket):  # type: ignore[no-untyped-def]  # torch compares annotations itself
            future: torch.futures.Future[torch.Tensor] = torch.futures.Future()
            future.set_result(bucket.buffer())
            return future

        wrapped = super()._setup_model(model)
        wrapped.register_comm_hook(None, own)
        return wrapped


def config(data_root: Path, output: Path, *overrides: str) -> DictConfig:
    keep = [f"+callbacks.keep._target_={HERE}.KeepRank", f"+callbacks.keep.directory={output}"]
    cfg = make_config(data_root, output, *BATCH, *keep, *overrides)
    # One process validates on two trajectories, the other on one; cubes, and so windows, differ in size.
    cfg.data.families.cube_drop.update({"count": 5, "valid": 3, "side": [0.2, 0.5]})
    return cfg


def work(rank: int, port: int, data_root: Path, runs: dict[Path, list[str]]) -> None:
    """Train as one of two processes, as if started by a launcher."""
    place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "NODE_RANK": "0", "LOCAL_RANK": str(rank)}
    os.environ |= place | {"WORLD_SIZE": "2"}
    torch.set_num_threads(1)
    for output, overrides in runs.items():
        try:
            train(config(data_root, output, "trainer.devices=2", *overrides), output, None)
        except SystemExit as error:  # all but the first process end here
            assert rank == 1 and error.code == 0


def load(output: Path, rank: int) -> dict[str, Any]:
    content: dict[str, Any] = torch.load(output / f"rank{rank}.pt", weights_only=True)
    return content


def distance(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> float:
    """Largest difference of any weight, relative to the largest of its tensor."""
    return max(
        float((value - two[name]).abs().max() / value.abs().max().clamp(min=1e-2)) for name, value in one.items()
    )


def test_two_processes_equal_one(tmp_path: Path) -> None:
    data_root, one, two, apart = (tmp_path / name for name in ("data", "one", "two", "apart"))
    for output in (one, two, apart):
        output.mkdir()
    train(config(data_root, one), one, None)
    runs = {two: [], apart: [f"+trainer.strategy._target_={HERE}.Unaveraged"]}
    start_processes(work, (free_port(), data_root, runs), 2)

    alone, first, second = load(one, 0), load(two, 0), load(two, 1)
    assert [a + b for a, b in zip(first["particles"], second["particles"], strict=True)] == alone["particles"]
    assert first["particles"] != second["particles"]  # windows of unequal size: a mean over particles would be wrong
    assert distance(first["weights"], second["weights"]) == 0
    # float32, summed in another order, and Adam divides by small numbers
    assert distance(alone["weights"], first["weights"]) < 1e-5
    # Control: had the gradients not been averaged, this would have been seen.
    assert distance(load(apart, 0)["weights"], load(apart, 1)["weights"]) > 1e-2
    assert distance(alone["weights"], load(apart, 0)["weights"]) > 1e-2

    for output in (one, two):  # one log, one writer
        assert len(list(output.glob("csv/*"))) == 1
        assert sorted(path.name for path in output.glob("*.ckpt")) == sorted(path.name for path in one.glob("*.ckpt"))
        assert not list(output.rglob("*.part"))
    compared = 0
    for row, other in zip(rows(one), rows(two), strict=True):
        for name, value in row.items():
            if value and name not in ("windows_per_s", "hours", "step_seconds", "valid/rollout_step_seconds"):
                assert float(other[name]) == pytest.approx(float(value), rel=1e-4, abs=1e-6), name
                compared += name.startswith("valid/")
    assert compared > 20


@pytest.mark.parametrize(("devices", "nodes", "shared"), [(1, 1, True), (2, 1, True), (2, 2, True), (3, 1, False)])
def test_windows_have_to_be_shared_alike(devices: int, nodes: int, shared: bool) -> None:
    trainer: Any = SimpleNamespace(num_devices=devices, num_nodes=nodes)
    if shared:
        check_devices(trainer, 4)
    else:
        with pytest.raises(InputError, match="batch_size=4 windows per step cannot be shared by 3 processes"):
            check_devices(trainer, 4)


def test_a_sweep_has_one_device_per_job(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lightning would start the whole sweep once more for the second device."""
    monkeypatch.setattr(HydraConfig, "initialized", lambda: True)
    monkeypatch.setattr(HydraConfig, "get", lambda: SimpleNamespace(mode=RunMode.MULTIRUN))
    check_devices(SimpleNamespace(num_devices=1, num_nodes=1), 4)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"every job on one device; set trainer\.devices=1"):
        check_devices(SimpleNamespace(num_devices=2, num_nodes=1), 4)  # type: ignore[arg-type]
