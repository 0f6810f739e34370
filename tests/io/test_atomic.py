"""A file appears whole or not at all."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from gns_pl.io import StorageError, atomic_path, remove_temporary_files
from gns_pl.io.atomic import write_atomically


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
