"""Pipes and devices in the place of files: told in a sentence, never waited for."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gns_pl.convert.formats import open_set
from gns_pl.convert.weights import inspect_weights
from gns_pl.errors import InputError
from gns_pl.io import read_header, read_manifest
from tests.convert.formats import test_fuzz


def pipe(path: Path) -> None:
    os.mkfifo(path)


def zeros(path: Path) -> None:
    path.symlink_to("/dev/zero")


@contextmanager
def in_time(path: Path, seconds: float = 5.0) -> Iterator[None]:
    """End a wait for a pipe by its other end, which then makes the test fail and not hang."""

    def close() -> None:
        os.close(os.open(path, os.O_RDWR))

    timer = threading.Timer(seconds, close)
    timer.start()
    try:
        yield
        assert timer.is_alive()
    finally:
        timer.cancel()


@pytest.mark.parametrize("replace", [pipe, zeros])
@pytest.mark.parametrize("make", test_fuzz.MAKERS, ids=lambda make: make.__name__.strip("_"))
def test_no_reader_opens_one(make: Callable[[Path], Path], replace: Callable[[Path], None], tmp_path: Path) -> None:
    """A deck that is one is none; everything else is told."""
    victim = make(tmp_path)
    victim.unlink()
    replace(victim)
    with in_time(victim):
        if victim.name == "mpm.json":
            assert any("no JSON deck was found" in note for note in open_set(tmp_path).stated.notes)
        else:
            with pytest.raises(InputError, match="is a pipe or a device, which is not read") as caught:
                test_fuzz.read_all(tmp_path)
            assert victim.name in str(caught.value)
        with pytest.raises(InputError, match="pipe or a device"):
            open_set(victim)


@pytest.mark.parametrize("replace", [pipe, zeros])
def test_a_named_deck_and_the_metadata_of_weights(tmp_path: Path, replace: Callable[[Path], None]) -> None:
    test_fuzz._cb_geo(tmp_path)
    replace(tmp_path / "other.json")
    with in_time(tmp_path / "other.json"), pytest.raises(InputError, match=r"other\.json: is a pipe or a device"):
        open_set(tmp_path, deck=tmp_path / "other.json")
    replace(tmp_path / "model.pt")
    with in_time(tmp_path / "model.pt"), pytest.raises(InputError, match=r"model\.pt"):
        inspect_weights(tmp_path / "model.pt", None)


@pytest.mark.parametrize("replace", [pipe, zeros])
@pytest.mark.parametrize("name", ["a.h5", "manifest.json"])
def test_a_set_of_ours(tmp_path: Path, replace: Callable[[Path], None], name: str) -> None:
    replace(tmp_path / name)
    with in_time(tmp_path / name), pytest.raises(InputError, match=rf"{name}: is a pipe or a device"):
        read_manifest(tmp_path) if name == "manifest.json" else read_header(tmp_path / name)


def test_a_link_to_nothing_is_told(tmp_path: Path) -> None:
    test_fuzz._npy(tmp_path)
    (tmp_path / "b.npy").symlink_to(tmp_path / "gone")
    with pytest.raises(InputError, match=r"b\.npy: no such file"):
        open_set(tmp_path)
    (tmp_path / "b.npy").unlink()
    (tmp_path / "metadata.json").symlink_to(tmp_path / "gone")
    with pytest.raises(InputError, match=r"metadata\.json: no such file"):
        open_set(tmp_path)


def test_settings_of_more_bytes_than_they_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    test_fuzz._geoelements(tmp_path)
    monkeypatch.setattr("gns_pl.io.regular.regular_size", lambda path: 0)
    monkeypatch.setattr("gns_pl.convert.formats.metadata.MOST_BYTES", 100)
    with pytest.raises(InputError, match="has 101 bytes, too many for settings"):
        open_set(tmp_path, trust=True)
