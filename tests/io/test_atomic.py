"""A file appears whole or not at all."""

from __future__ import annotations

import errno
import math
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from gns_pl.io import StorageError, atomic_path, remove_temporary_files
from gns_pl.io.atomic import free_bytes, write_atomically


def refuse(code: int):
    def refused(*args: object) -> None:
        raise OSError(code, os.strerror(code))

    return refused


def test_replaces_at_the_end_only(tmp_path: Path) -> None:
    target = tmp_path / "data.bin"
    target.write_bytes(b"old")
    with atomic_path(target) as temporary:
        assert temporary.parent == tmp_path
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [target]


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "data.bin"
    target.write_bytes(b"old")
    with pytest.raises(KeyError), atomic_path(target) as temporary:
        temporary.write_bytes(b"half")
        raise KeyError
    with (
        pytest.raises(StorageError, match=r"data\.bin: cannot be written \(No space left"),
        atomic_path(target) as part,
    ):
        part.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No such file or directory"):
        write_atomically(tmp_path / "none" / "data.bin", b"x")


def test_leftovers_are_removed_and_nothing_else(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a.h5") as temporary:
        leftover = temporary.with_name(temporary.name)
        temporary.write_bytes(b"x")
    leftover.write_bytes(b"half")  # as a killed writer leaves it
    other = tmp_path / ".keep"
    other.touch()
    remove_temporary_files(tmp_path, "b.h5")
    assert leftover.exists()
    remove_temporary_files(tmp_path, "a.h5")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".keep", "a.h5"]


@pytest.mark.parametrize("code", [errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_system_that_cannot_sync_takes_files(code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", refuse(code))
    write_atomically(tmp_path / "data.bin", b"whole")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"whole"]


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
def test_content_that_was_lost_is_told(code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", refuse(code))
    with pytest.raises(StorageError, match=r"data\.bin: cannot be written"):
        write_atomically(tmp_path / "data.bin", b"lost")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_opened_takes_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One may write into it without listing it; some network shares open no folder at all."""
    usual = os.open

    def only_files(path: Path, flags: int, mode: int = 0o777) -> int:
        if Path(path).is_dir():
            raise PermissionError(errno.EACCES, "Permission denied")
        return usual(path, flags, mode)

    monkeypatch.setattr(os, "open", only_files)
    write_atomically(tmp_path / "data.bin", b"whole")
    assert (tmp_path / "data.bin").read_bytes() == b"whole"


def test_room_that_a_file_system_does_not_know_is_no_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert 0 < free_bytes(tmp_path) < math.inf
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(total=0, free=0))
    assert free_bytes(tmp_path) == math.inf
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(total=10, free=0))
    assert free_bytes(tmp_path) == 0
    monkeypatch.setattr(shutil, "disk_usage", refuse(errno.ENOSYS))
    assert free_bytes(tmp_path) == math.inf
