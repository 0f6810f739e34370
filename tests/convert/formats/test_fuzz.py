"""Damaged and cut files of every format: a sentence or a sound recording, never a crash, a hang or anything written."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gns_pl.convert.formats import open_set
from gns_pl.errors import InputError
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling

LONGEST = 5.0
"""Seconds that no damage may take; sound files of this size take some milliseconds."""


def _geoelements(folder: Path) -> Path:
    fixtures.write_geoelements(folder, {"train": [falling(3, side=2)]}, np.full(8, 6), np.float64(0.5))
    return folder / "train.npz"


def _structured(folder: Path) -> Path:
    np.savez(folder / "a.npz", position=falling(3, side=2), particle_type=np.full(8, 6))
    return folder / "a.npz"


def _npy(folder: Path) -> Path:
    (folder / "a.npy").write_bytes(fixtures.npy_bytes(falling(3, side=2)))
    return folder / "a.npy"


def _groups(folder: Path) -> Path:
    fixtures.write_lagrangebench(folder, {"train": [falling(3, side=2)]}, np.zeros(8, dtype=np.int64))
    return folder / "train.h5"


def _groups_of_v2(folder: Path) -> Path:
    fixtures.write_geoelements_hdf5(folder / "train.h5", [falling(3, side=2)], np.full(8, 6), 0.5)
    return folder / "train.h5"


def _tfrecord(folder: Path) -> Path:
    fixtures.write_tfrecord(folder / "train.tfrecord", [falling(3, side=2)], np.full(8, 6))
    return folder / "train.tfrecord"


def _cb_geo(folder: Path) -> Path:
    fixtures.write_cb_geo(folder, falling(2, side=2).astype(np.float64))
    fixtures.write_deck(folder)
    return folder / "particles00000.h5"


def _deck(folder: Path) -> Path:
    _cb_geo(folder)
    return folder / "mpm.json"


def _mesh(folder: Path) -> Path:
    _cb_geo(folder)
    return folder / "mesh.txt"


def _vtk(folder: Path) -> Path:
    fixtures.write_vtk(folder, falling(2, side=2))
    return folder / "run_1.vtp"


def _vtk_list(folder: Path) -> Path:
    fixtures.write_vtk(folder, falling(2, side=2))
    return folder / "run.pvd"


def _metadata(folder: Path) -> Path:
    _geoelements(folder)
    return folder / "metadata.json"


MAKERS: list[Callable[[Path], Path]] = [
    _geoelements, _structured, _npy, _groups, _groups_of_v2, _tfrecord, _cb_geo, _deck, _mesh, _vtk, _vtk_list,
    _metadata,
]  # fmt: skip


def read_all(folder: Path) -> None:
    """Read a folder to its end, as a conversion would."""
    found = open_set(folder, trust=True)
    for number in range(len(found.names)):
        with found.recording(number) as recording:
            for frame in range(recording.num_frames):
                assert np.isfinite(recording.frames(frame, frame + 1)).all()


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__.strip("_"))
def test_sound_files_are_read(make: Callable[[Path], Path], tmp_path: Path) -> None:
    make(tmp_path)
    read_all(tmp_path)


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__.strip("_"))
@given(data=st.data())
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_damage_is_told_in_a_sentence(make: Callable[[Path], Path], data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        victim = make(folder)
        content = bytearray(victim.read_bytes())
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        if data.draw(st.booleans(), label="cut"):
            content = content[: data.draw(st.integers(0, len(content) - 1), label="length")]
        else:
            for _ in range(data.draw(st.integers(1, 4), label="changes")):
                place = data.draw(st.integers(0, min(len(content), 1500) - 1), label="place")
                content[place] = data.draw(st.integers(0, 255), label="byte")
        victim.write_bytes(content)
        before[victim] = bytes(content)
        began = time.monotonic()
        try:
            read_all(folder)
        except InputError as error:
            assert "\n" not in str(error) and str(error).endswith((".", "…")) and os.fspath(folder) in str(error)
        assert time.monotonic() - began < LONGEST
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_any_bytes_of_any_ending(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        for file in ("a.npz", "a.npy", "train.h5", "a.tfrecord", "a.vtp", "a.pvd", "particles0.h5"):
            path = Path(name) / file
            path.write_bytes(content)
            source = path if not file.startswith("particles") else path.parent
            with pytest.raises(InputError):
                found = open_set(source, trust=True)
                with found.recording(0) as recording:
                    recording.frames(0, 1)
            path.unlink()
