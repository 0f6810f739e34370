"""What is no regular file is refused before it is opened: a pipe would wait for ever."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gns_pl.errors import InputError
from gns_pl.io.regular import read_bounded, regular_size


def test_the_size_of_a_file_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert regular_size(tmp_path / "a") == regular_size(tmp_path / "b") == 5


def test_a_pipe_and_a_device_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match=r"is a pipe or a device.*put a regular file"):
            read_bounded(path, 10, "settings")


def test_what_is_not_there_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        regular_size(tmp_path / "nothing")
    with pytest.raises(IsADirectoryError):
        read_bounded(tmp_path, 10**6, "settings")


@pytest.mark.parametrize(("size", "fits"), [(0, True), (8, True), (9, False)])
def test_no_more_is_read_than_may_be(tmp_path: Path, size: int, fits: bool) -> None:
    (tmp_path / "a").write_bytes(b"x" * size)
    if fits:
        assert read_bounded(tmp_path / "a", 8, "settings") == b"x" * size
    else:
        with pytest.raises(InputError, match="has 9 bytes, too many for settings"):
            read_bounded(tmp_path / "a", 8, "settings")


def test_a_file_that_says_it_is_empty_and_is_not() -> None:
    """Files of /proc have no size until they are read."""
    assert regular_size(Path("/proc/self/status")) == 0
    with pytest.raises(InputError, match="too many for a name"):
        read_bounded(Path("/proc/self/status"), 10, "a name")
