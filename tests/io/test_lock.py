"""One at a time, and a lock file without an owner means nothing."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
from pathlib import Path

import pytest

from gns_pl.io import StorageError, lock
from gns_pl.io.lock import claim, locked, open_lock


def test_the_second_says_so_and_waits(tmp_path: Path) -> None:
    told, entered = threading.Event(), threading.Event()

    def second() -> None:
        with locked(tmp_path / ".lock", told.set):
            entered.set()

    thread = threading.Thread(target=second)
    with locked(tmp_path / ".lock"):
        thread.start()
        assert told.wait(5)
        assert not entered.wait(0.1)
    assert entered.wait(5)
    thread.join()


def test_a_file_left_behind_does_not_block(tmp_path: Path) -> None:
    (tmp_path / ".lock").touch()
    with locked(tmp_path / ".lock", lambda: pytest.fail("waited")):
        pass


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="cannot be written"), locked(tmp_path / "none" / ".lock"):
        pass


@pytest.mark.parametrize("code", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL])
@pytest.mark.parametrize("inherited", [True, False])
def test_a_file_system_without_locks_is_told_once_and_used(
    code: int, inherited: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(code, os.strerror(code))

    lock._say_no_locks.cache_clear()
    monkeypatch.setattr(fcntl, "flock" if inherited else "lockf", refuse)
    for name in ("a", "b"):
        descriptor = open_lock(tmp_path / name)
        assert not claim(descriptor, tmp_path / name, wait=False, inherited=inherited)
        os.close(descriptor)
    if inherited:
        with locked(tmp_path / "a", lambda: pytest.fail("waited")) as held:
            assert not held
    said = f"{tmp_path}: its file system has no locks ({os.strerror(code)}); let one process at a time write there.\n"
    assert capsys.readouterr().err == said


def test_a_lock_that_can_be_had_says_so(tmp_path: Path) -> None:
    with locked(tmp_path / ".lock") as held:
        assert held
