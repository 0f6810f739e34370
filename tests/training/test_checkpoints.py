"""Which checkpoints a run keeps, and that neither a damaged one nor a full disk loses what was there before."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.io import StorageError
from gns_pl.training.checkpoints import AtomicCheckpointIO
from gns_pl.training.resume import exclusive, steps_made
from gns_pl.training.train import train
from tests.training.conftest import assert_same, make_config, rows

SETTINGS = ("callbacks.last.every_n_steps=1", "callbacks.last.keep=4")


@pytest.fixture(scope="module")
def whole(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted run of six steps, validated after the third and the sixth."""
    output = tmp_path_factory.mktemp("whole")
    train(make_config(data_root, output, *SETTINGS), output, None)
    return output


def names(output: Path) -> list[str]:
    ours = (".ckpt", ".lock", ".part")  # not the run's summary and figure
    return sorted(path.name for path in output.iterdir() if path.name.endswith(ours))


def test_the_last_few_and_the_best_are_kept(whole: Path) -> None:
    numbered = [f"step000000{step}.ckpt" for step in (3, 4, 5, 6)]
    assert names(whole) == [".lock", "best.ckpt", "last.ckpt", *numbered]
    assert (whole / "last.ckpt").read_bytes() == (whole / numbered[-1]).read_bytes()
    content = {name: torch.load(whole / name, weights_only=True) for name in ("best.ckpt", "last.ckpt")}
    errors = [float(row["valid/position_error"]) for row in rows(whole) if row["valid/position_error"]]
    best = content["best.ckpt"]
    assert best["global_step"] == 3 * (1 + errors.index(min(errors)))
    for each in content.values():
        assert each["callbacks"]["BestCheckpoint"]["least"] == pytest.approx(min(errors), rel=1e-6)


@pytest.mark.parametrize("step", [3, 4])  # saved behind a validation, and behind a training step
def test_going_on_from_an_older_one_gives_the_same_checkpoints_and_log(
    data_root: Path, tmp_path: Path, whole: Path, step: int
) -> None:
    tmp_path.joinpath("best.ckpt").write_bytes((whole / "best.ckpt").read_bytes())
    train(make_config(data_root, tmp_path, *SETTINGS), tmp_path, whole / f"step000000{step}.ckpt")
    for name in ("last.ckpt", "best.ckpt", "step0000005.ckpt"):
        assert_same(*(torch.load(folder / name, weights_only=True) for folder in (whole, tmp_path)))
    logged = {
        folder: [(row["step"], row["loss"]) for row in rows(folder) if row["loss"]] for folder in (whole, tmp_path)
    }
    assert logged[tmp_path] == logged[whole][step:]


def test_only_so_many_are_kept_and_those_written_last(data_root: Path, tmp_path: Path) -> None:
    tmp_path.joinpath("step0009000.ckpt").touch()  # of an older run in the folder
    cfg = make_config(data_root, tmp_path, "callbacks.last.every_n_steps=1", "callbacks.last.keep=1")
    train(cfg, tmp_path, None)
    assert names(tmp_path) == [".lock", "best.ckpt", "last.ckpt", "step0000006.ckpt"]
    with pytest.raises(InputError, match=r"callbacks\.last\.keep must be a whole number of at least 1, not 0"):
        train(make_config(data_root, tmp_path, "callbacks.last.keep=0"), tmp_path, None)


def test_a_damaged_checkpoint_names_the_newest_good_one(data_root: Path, tmp_path: Path, whole: Path) -> None:
    settings: dict[str, Any] = {}
    for name in ("last.ckpt", "best.ckpt", "step0000003.ckpt", "step0000004.ckpt", "step0000005.ckpt"):
        tmp_path.joinpath(name).write_bytes((whole / name).read_bytes())
    for name in ("last.ckpt", "step0000005.ckpt"):
        content = tmp_path.joinpath(name).read_bytes()
        tmp_path.joinpath(name).write_bytes(content[: len(content) // 2])
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(InputError, match=r"last\.ckpt: is not a readable checkpoint") as caught:
        train(make_config(data_root, tmp_path), tmp_path, tmp_path / "last.ckpt")
    good = tmp_path / "step0000004.ckpt"
    assert f"resume={good} hydra.run.dir={tmp_path}" in str(caught.value)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    train(make_config(data_root, tmp_path, *SETTINGS), tmp_path, good)
    assert_same(*(torch.load(folder / "last.ckpt", weights_only=True) for folder in (whole, tmp_path)))
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone/last.ckpt").write_bytes(b"")
    with pytest.raises(InputError, match="no good one beside it; resume=null"):
        steps_made(tmp_path / "alone/last.ckpt", settings)


def test_a_full_disk_is_one_sentence_and_loses_nothing(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(make_config(data_root, tmp_path, "trainer.max_steps=2"), tmp_path, None)
    before = names(tmp_path)
    kept = (tmp_path / "last.ckpt").read_bytes()
    write = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if ".ckpt" in path.name:
            write(path, content[:1000])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    sentence = (
        r"best\.ckpt: cannot be written \(No space left on device\); make room and go on: add resume=.*last\.ckpt"
    )
    with pytest.raises(StorageError, match=sentence):
        train(make_config(data_root, tmp_path, *SETTINGS), tmp_path, tmp_path / "last.ckpt")
    assert names(tmp_path) == before and (tmp_path / "last.ckpt").read_bytes() == kept


def test_a_checkpoint_replaces_another_only_when_whole(tmp_path: Path) -> None:
    path = tmp_path / "last.ckpt"
    AtomicCheckpointIO().save_checkpoint({"value": torch.ones(3)}, path)
    with pytest.raises(Exception, match="pickle"):
        AtomicCheckpointIO().save_checkpoint({"value": lambda: 0}, path)
    assert torch.equal(torch.load(path, weights_only=True)["value"], torch.ones(3))
    assert names(tmp_path) == ["last.ckpt"]


def test_a_folder_has_one_run_at_a_time(tmp_path: Path) -> None:
    leftover = tmp_path / ".last.ckpt.123-abc.part"
    hold = (
        "import fcntl, sys, time; f = open(sys.argv[1], 'w'); fcntl.lockf(f, fcntl.LOCK_EX); print('held', flush=True)"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", f"{hold}; time.sleep(60)", str(tmp_path / ".lock")], stdout=subprocess.PIPE
    )
    try:
        assert other.stdout is not None and other.stdout.readline() == b"held\n"
        leftover.touch()
        with pytest.raises(InputError, match=r"another train\.py is at work"), exclusive(tmp_path):
            pass
        assert leftover.exists()  # it may be the other one's
    finally:
        other.kill()
        other.communicate()
    with exclusive(tmp_path):  # a lock goes with its process, however that ended
        assert not leftover.exists()


def test_a_file_system_without_locks_takes_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*args: object) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr("fcntl.lockf", refuse)
    leftover = tmp_path / ".last.ckpt.123-abc.part"
    leftover.touch()
    with exclusive(tmp_path):
        assert leftover.exists()  # it may be another one's
    assert f"{tmp_path}: its file system has no locks" in capsys.readouterr().err
