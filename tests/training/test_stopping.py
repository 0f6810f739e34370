"""What ends a run early leaves a checkpoint that goes on exactly, or one from before anything went wrong."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning.pytorch import Callback, LightningModule, Trainer

from gns_pl.data.datamodule import _leave_signals_to_parent
from gns_pl.errors import InputError
from gns_pl.training.summary import read_summary
from gns_pl.training.train import train
from tests.training.conftest import assert_same, make_config

HERE = "tests.training.test_stopping"


class SignalAt(Callback):
    """Sends this process a signal while a step is being made."""

    def __init__(self, step: int, number: int) -> None:
        self.step, self.number = step, number

    def on_before_optimizer_step(self, trainer: Trainer, pl_module: LightningModule, optimizer: Any) -> None:
        if trainer.global_step == self.step:
            os.kill(os.getpid(), self.number)


class SpoilAt(Callback):
    """Makes a weight infinite before a step, or after it but before it is saved."""

    def __init__(self, step: int, after: bool) -> None:
        self.step, self.after = step, after

    def _spoil(self, module: LightningModule) -> None:
        with torch.no_grad():
            next(module.parameters())[0, 0] = torch.inf

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        if not self.after and trainer.global_step == self.step:
            self._spoil(pl_module)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        if self.after and trainer.global_step == self.step + 1:
            self._spoil(pl_module)


def callback(name: str, **arguments: object) -> list[str]:
    settings = {"_target_": f"{HERE}.{name}", **arguments}
    return [f"+callbacks.extra.{key}={value}" for key, value in settings.items()]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGUSR1])
def test_a_signal_ends_the_run_behind_the_step(
    data_root: Path, whole_run: Path, tmp_path: Path, number: signal.Signals
) -> None:
    cut = tmp_path / "cut"
    handler = signal.getsignal(number)
    with pytest.raises(SystemExit, match=r"stopped after 4 steps; to go on, add resume=.*last\.ckpt hydra\.run\.dir="):
        train(make_config(data_root, cut, *callback("SignalAt", step=3, number=int(number))), cut, None)
    assert signal.getsignal(number) == handler
    train(make_config(data_root, cut), cut, cut / "last.ckpt")
    for name in ("last.ckpt", "best.ckpt"):
        assert_same(*(torch.load(folder / name, weights_only=True) for folder in (whole_run, cut)))


def test_time_is_up(data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each start has its time, and the run that was stopped goes on exactly."""
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    long = [
        "training.optimisation.num_steps=100000",
        "trainer.val_check_interval=100000",
        "trainer.log_every_n_steps=50",
    ]
    made = [0]
    resume = None
    for _ in range(2):
        resume = train(make_config(data_root, cut, *long, "trainer.max_time=00:00:00:01"), cut, resume)
        made.append(torch.load(resume, weights_only=True)["global_step"])
        assert f"Stopped after {made[-1]} of 100000 steps; to go on, add resume={resume}" in capsys.readouterr().out
    assert 0 < made[1] < made[2]
    train(make_config(data_root, cut, *long, f"trainer.max_steps={made[2] + 2}"), cut, resume)
    train(make_config(data_root, whole, *long, f"trainer.max_steps={made[2] + 2}"), whole, None)
    assert_same(*(torch.load(folder / "last.ckpt", weights_only=True) for folder in (whole, cut)))


@pytest.mark.parametrize(("after", "what"), [(False, "the loss is"), (True, "the weights are")])
def test_what_is_not_finite_stops_the_run(
    data_root: Path, whole_run: Path, tmp_path: Path, after: bool, what: str
) -> None:
    cut = tmp_path / "cut"
    cfg = make_config(data_root, cut, *callback("SpoilAt", step=3, after=after), "callbacks.last.every_n_steps=2")
    with pytest.raises(InputError, match=rf"{what} not finite in step 3.*last\.ckpt is from before.*learning_rate"):
        train(cfg, cut, None)
    assert torch.load(cut / "last.ckpt", weights_only=True)["global_step"] == 3  # behind the validation
    saved = torch.load(cut / "not_finite_step0000003.pt", weights_only=True)
    assert saved["step"] == 3 and saved["seed"] == 0
    assert {step: [w["number"] for w in windows] for step, windows in saved["windows"].items()} == {
        2: [4, 5],
        3: [6, 7],
    }
    for windows in saved["windows"].values():
        for window in windows:
            assert window["trajectory"].endswith(".h5") and window["frame"] >= 0
            assert window["position"].shape[1:] == (5, 3) and window["position"].isfinite().all()
    train(make_config(data_root, cut), cut, cut / "last.ckpt")
    assert_same(*(torch.load(folder / "last.ckpt", weights_only=True) for folder in (whole_run, cut)))


class Seen(Callback):
    """Notes the windows that a step was made of."""

    batches: list[Any] = []  # noqa: RUF012

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        self.batches.append((trainer.global_step, batch))


def test_the_windows_saved_are_those_of_the_step(data_root: Path, tmp_path: Path) -> None:
    Seen.batches.clear()
    seen = [f"+callbacks.seen._target_={HERE}.Seen"]
    with pytest.raises(InputError):
        train(make_config(data_root, tmp_path, *seen, *callback("SpoilAt", step=3, after=False)), tmp_path, None)
    saved = torch.load(tmp_path / "not_finite_step0000003.pt", weights_only=True)["windows"]
    for step, batch in Seen.batches[2:]:
        for name in ("position", "particle_type", "material", "volume", "lower", "upper", "gravity"):
            assert torch.equal(torch.cat([window[name] for window in saved[step]]), batch[name]), name


class EndWorkers(Callback):
    """Sends all processes of the training SIGTERM, as a batch system does."""

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        if trainer.global_step == 2:
            workers = multiprocessing.active_children()
            assert len(workers) == 2
            for worker in workers:
                os.kill(int(worker.pid or 0), signal.SIGUSR1)
                os.kill(int(worker.pid or 0), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1)  # torch looks after its loader processes whenever one ends


def test_loader_processes_end_with_the_run_and_not_before(data_root: Path, whole_run: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut"
    workers = ["training.num_workers=2", f"+callbacks.extra._target_={HERE}.EndWorkers"]
    with pytest.raises(SystemExit, match=r"stopped after 3 steps; to go on, add resume="):
        train(make_config(data_root, cut, *workers), cut, None)
    assert torch.load(cut / "last.ckpt", weights_only=True)["global_step"] == 3
    summary = read_summary(cut)
    assert summary is not None and summary["data"]["num_valid"] == 1
    assert not multiprocessing.active_children()
    train(make_config(data_root, cut), cut, cut / "last.ckpt")
    assert_same(*(torch.load(folder / "last.ckpt", weights_only=True) for folder in (whole_run, cut)))


def test_a_loader_process_obeys_sigterm_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns_pl.data.datamodule.LOADER_GRACE", 1)
    context = multiprocessing.get_context("fork")
    ready = context.Event()
    worker = context.Process(target=_as_loader, args=(ready,), daemon=True)
    worker.start()
    assert ready.wait(20)
    os.kill(int(worker.pid or 0), signal.SIGUSR1)
    worker.terminate()
    worker.join(0.3)
    assert worker.is_alive()
    worker.join(20)
    assert worker.exitcode == -signal.SIGALRM


def _as_loader(ready: Any) -> None:
    _leave_signals_to_parent(0)
    ready.set()
    time.sleep(60)


def test_in_a_slurm_job_usr1_stops_the_run(
    data_root: Path, whole_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lightning would save into the working folder, ask for the job again, and begin every later run there."""
    slurm = {"JOB_ID": "77", "JOB_NAME": "night", "NTASKS": "1", "PROCID": "0", "LOCALID": "0", "NODEID": "0"}
    for name, value in slurm.items():
        monkeypatch.setenv(f"SLURM_{name}", value)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    (tmp_path / "work/hpc_ckpt_1.ckpt").write_bytes(b"of another run")
    cut = tmp_path / "cut"
    number = int(signal.SIGUSR1)
    with pytest.raises(SystemExit, match=r"stopped after 4 steps; to go on, add resume="):
        train(make_config(data_root, cut, *callback("SignalAt", step=3, number=number)), cut, None)
    assert [path.name for path in Path().iterdir()] == ["hpc_ckpt_1.ckpt"] and not list(cut.rglob("hpc*"))
    train(make_config(data_root, cut), cut, cut / "last.ckpt")
    assert_same(*(torch.load(folder / "last.ckpt", weights_only=True) for folder in (whole_run, cut)))
