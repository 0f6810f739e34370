"""One at a time, and a lock file without an owner means nothing."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from gns_pl.generation.lock import locked
from gns_pl.io import StorageError


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
