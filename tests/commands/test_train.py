"""python train.py as a user types it, in a folder of his own."""

from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from gns_pl.generation import generate_dataset
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.models.corrector import load_corrector
from gns_pl.training.summary import read_summary
from tests.commands.in_process import ROOT, call
from tests.conftest import start_process
from tests.offline_run import OfflineRun, media, read_offline_run
from tests.training.conftest import TINY, assert_same

ONE_FAMILY = [f"data.families.cube_drop.{setting}" for setting in ("count=3", "duration=0.2", "valid=1", "test=0")]


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, str(ROOT / "train.py"), *arguments]
    threads = {"OMP_NUM_THREADS": "1"}  # the same sums on a busy machine
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=folder, text=True, env=os.environ | threads, **pipes)  # type: ignore[call-overload]


def finish(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    try:
        stdout, stderr = process.communicate(timeout=300)
    except BaseException:
        process.kill()
        raise
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return call(folder, "train.py", *arguments)


def run_on_one_thread(folder: Path, *arguments: str) -> None:
    torch.set_num_threads(1)
    run(folder, *arguments)


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def tiny(*more: str) -> list[str]:
    import yaml

    families = yaml.safe_load((ROOT / "conf/data/quickstart.yaml").read_text())["families"]
    others = [f"~data.families.{name}" for name in families if name != "cube_drop"]
    return [*TINY, *ONE_FAMILY, *others, *more]


def test_train_again_and_sweep(tmp_path: Path) -> None:
    first = finish(start(tmp_path, *tiny()))
    assert first.returncode == 0, first.stderr
    last = tmp_path / "runs/quickstart/last.ckpt"
    assert "evaluate.py ckpt=" in first.stdout and load_checkpoint(last).provenance["steps"] == 6
    assert list((last.parent / "wandb").glob("offline-run-*")) and list((last.parent / "csv").glob("*/metrics.csv"))
    media = last.parent.glob("wandb/offline-run-*/files/media/images/**/*.png")
    shown = sorted(path.name.split("_")[0] for path in media)
    assert shown == ["curves", "curves", "deposit", "deposit", "learning"]  # two validations, and the end
    assert (last.parent / "learning_curve.png").is_file() and read_summary(last.parent) is not None
    before = last.read_bytes()

    again = run(tmp_path, *tiny())  # trained already: nothing is redone or lost
    assert again.returncode == 0, again.stderr
    assert last.read_bytes() == before

    changed = run(tmp_path, *tiny("training.noise_std=0.1"))
    assert changed.returncode == 2 and "training.noise_std" in changed.stderr and "Traceback" not in changed.stderr

    sweep = run(tmp_path, "-m", *tiny("model.num_message_passing_steps=1,2", "hydra.sweep.dir=runs/sweep"))
    assert sweep.returncode == 0, sweep.stderr
    jobs = sorted((tmp_path / "runs/sweep").glob("*/last.ckpt"))
    assert [load_checkpoint(job).simulator.config.num_message_passing_steps for job in jobs] == [1, 2]
    assert all(len(list((job.parent / "wandb").glob("offline-run-*"))) == 1 for job in jobs)
    rows = read_rows(tmp_path / "runs/sweep/sweep.csv")
    assert [row["model.num_message_passing_steps"] for row in rows] == ["1", "2"]
    assert all(float(row["position_error"]) > 0 and float(row["rollout_step_ms"]) > 0 for row in rows)
    assert (tmp_path / "runs/sweep/sweep.png").is_file() and "sweep.md" in sweep.stdout
    whole, *members = written_runs(tmp_path / "runs/sweep", 3)
    assert {offline.group for offline in (whole, *members)} == {"runs_sweep"}
    assert [offline.job_type for offline in (whole, *members)] == ["sweep", "training", "training"]
    for row, job, offline in zip(rows, jobs, members, strict=True):
        summary, steps = read_summary(job.parent), row["model.num_message_passing_steps"]
        assert summary is not None and offline.config["model"]["num_message_passing_steps"] == int(steps)
        assert offline.summary["valid/position_error"] == pytest.approx(summary["final"]["position_error"])
        error = whole.summary[f"model.num_message_passing_steps={steps}/position_error"]
        assert error == pytest.approx(float(row["position_error"])) == pytest.approx(summary["best"]["position_error"])
    assert whole.summary["num_jobs"] == 2 and whole.summary["num_failed"] == 0

    broken, before = jobs[1].parent, jobs[0].read_bytes()
    ended = torch.load(broken / "last.ckpt", weights_only=True)
    (broken / "step0000004.ckpt").replace(broken / "last.ckpt")  # as a kill leaves it
    for name in ("step0000006.ckpt", "summary.json"):
        (broken / name).unlink()
    again = run(tmp_path, "-m", *tiny("model.num_message_passing_steps=1,2", "hydra.sweep.dir=runs/sweep"))
    assert again.returncode == 0 and jobs[0].read_bytes() == before and "has made its 6 steps already" in again.stdout
    assert_same(torch.load(broken / "last.ckpt", weights_only=True), ended)
    assert [row["status"] for row in read_rows(tmp_path / "runs/sweep/sweep.csv")] == ["finished", "finished"]


def written_runs(folder: Path, number: int) -> list[OfflineRun]:
    """The runs of W&B below a folder, by their folders, with all their media: W&B's own process may write a while."""
    deadline = time.monotonic() + 20
    while len(list(folder.glob("**/run-*.wandb"))) < number and time.monotonic() < deadline:
        time.sleep(0.1)
    found = sorted(folder.glob("**/offline-run-*"), key=lambda path: len(path.parts))
    assert len(found) == number
    runs = [read_offline_run(path) for path in sorted(found, key=lambda path: (len(path.parts), path))]
    shown = [media(path, run) for path, run in zip(found, runs, strict=True)]
    assert shown[0] == {"jobs", "sweep_figure"} and all("learning_curve" in names for names in shown[1:])
    return runs


def test_a_corrector_is_trained_and_swept_by_the_same_command(tmp_path: Path) -> None:
    from tests.training import test_correction as correction

    families = {"low": {**correction.DATA["families"]["low"], "count": 2}}
    generate_dataset({**correction.DATA, "families": families, "root": str(tmp_path / "data")}, device="cpu")
    arguments = [each for each in correction.TINY if "num_train" not in each and "num_steps" not in each]
    arguments += ["data=data/every_3", "model.mpm.cell_size=0.125", "training.optimisation.num_steps=2"]
    sweep = run(tmp_path, "-m", *arguments, "training.position_gain=0.1,0.2", "hydra.sweep.dir=runs/sweep")
    assert sweep.returncode == 0, sweep.stderr
    rows = read_rows(tmp_path / "runs/sweep/sweep.csv")
    assert [row["training.position_gain"] for row in rows] == ["0.1", "0.2"]
    assert all(row["status"] == "finished" and float(row["position_error"]) > 0 for row in rows)
    made = sorted((tmp_path / "runs/sweep").glob("*/tiny.corrector"))
    gains = [load_corrector(path).provenance["config"]["training"]["position_gain"] for path in made]
    assert gains == [0.1, 0.2] and "simulate.py ckpt=" in sweep.stdout

    judged = call(tmp_path, "evaluate.py", f"ckpt={made[0]}")
    assert judged.returncode == 2 and "corrects coarse MPM" in judged.stderr


@pytest.mark.slow
def test_a_bad_job_does_not_end_a_sweep(tmp_path: Path) -> None:
    sweep = run(tmp_path, "-m", *tiny("training.noise_std=-1,1e-4", "hydra.sweep.dir=runs/sweep", "~logger.wandb"))
    assert sweep.returncode != 0 and "noise_std must not be negative" in sweep.stderr
    assert [path.parent.name[0] for path in (tmp_path / "runs/sweep").glob("*/last.ckpt")] == ["1"]
    rows = read_rows(tmp_path / "runs/sweep/sweep.csv")
    assert [row["status"] for row in rows] == ["failed", "finished"] and "noise_std" in rows[0]["error"]
    assert rows[0]["position_error"] == "" and float(rows[1]["position_error"]) > 0
    assert not list((tmp_path / "runs/sweep").glob("**/wandb"))


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [("resume=nowhere.ckpt", "no such checkpoint"), ("training.noise_std=-1", "noise_std must not be negative")],
)
def test_bad_input_is_one_sentence(tmp_path: Path, argument: str, sentence: str) -> None:
    result = run(tmp_path, *tiny(argument, "~logger.wandb"))
    assert result.returncode == 2
    assert result.stderr.strip().splitlines()[-1].startswith("train.py: ") and sentence in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_advice_instead_of_a_training(tmp_path: Path) -> None:
    result = run(tmp_path, *tiny("advise=true"))
    assert result.returncode == 0, result.stderr
    output = tmp_path / "runs/quickstart"
    assert "neighbours within it" in result.stdout and (output / "advice.json").is_file()
    assert not (output / "last.ckpt").exists() and not (output / "csv").exists()


def test_killed_anywhere_and_resumed_it_ends_where_an_uninterrupted_run_does(tmp_path: Path) -> None:
    """Weights, average, optimiser, schedule, progress and best checkpoint, to the last bit."""
    arguments = tiny("~logger.wandb", "training.optimisation.num_steps=100", "trainer.val_check_interval=30")
    arguments += ["callbacks.last.every_n_steps=7"]
    folders = {name: tmp_path / name for name in ("killed", "whole")}
    killed = start_process(run_on_one_thread, tmp_path, *arguments, "hydra.run.dir=killed")
    try:
        deadline = time.monotonic() + 200
        late = "step0000014.ckpt"
        while max((p.name for p in folders["killed"].glob("step*")), default="") < late and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(random.uniform(0, 0.4))
    finally:
        killed.kill()
        killed.join()
    assert killed.exitcode == -signal.SIGKILL
    before = torch.load(folders["killed"] / "last.ckpt", weights_only=True)["global_step"]
    assert 0 < before < 100
    for name in folders:
        done = run(tmp_path, *arguments, f"hydra.run.dir={name}")
        assert done.returncode == 0, done.stderr
    for name in ("last.ckpt", "best.ckpt"):
        assert_same(*(torch.load(folder / name, weights_only=True) for folder in folders.values()))
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.slow
def test_two_devices(tmp_path: Path) -> None:
    result = finish(start(tmp_path, *tiny("trainer.devices=2", "trainer.accelerator=cpu")))
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("To judge its last state:") == 1 and "6 steps on cpu and 1 more" in result.stdout
    output = tmp_path / "runs/quickstart"
    assert load_checkpoint(output / "last.ckpt").provenance["steps"] == 6
    assert len(list((output / "wandb").glob("offline-run-*"))) == len(list((output / "csv").iterdir())) == 1
