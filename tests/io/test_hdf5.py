"""Trajectories come back bit for bit, whole or in windows; what is broken is named."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import gns_pl.io.hdf5
from gns_pl.errors import InputError
from gns_pl.fields import OBSERVED
from gns_pl.io import (
    open_trajectory,
    read_header,
    read_observables,
    read_static,
    read_trajectory,
    read_window,
    write_trajectory,
)
from gns_pl.metrics.observables import compute_observables
from gns_pl.scene import FACES, Material, Scene, Wall, column_collapse
from gns_pl.trajectory import Trajectory
from tests.conftest import make_moving


@pytest.fixture
def trajectory(drop: Scene) -> Trajectory:
    made = {"solver": "none", "seed": 3, "nested": {"a": [1, 2.5, None]}}
    return replace(make_moving(drop, frames=23, spacing=0.06), provenance=made)


@pytest.fixture
def path(trajectory: Trajectory, tmp_path: Path) -> Path:
    write_trajectory(tmp_path / "drop.h5", trajectory)
    return tmp_path / "drop.h5"


def assert_same(a: Trajectory, b: Trajectory) -> None:
    for field in fields(Trajectory):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            assert left.dtype == right.dtype
            assert left.tobytes() == right.tobytes()
        else:
            assert left == right


def test_round_trip_is_exact(trajectory: Trajectory, path: Path) -> None:
    assert_same(read_trajectory(path), trajectory)
    assert [entry.name for entry in path.parent.iterdir()] == ["drop.h5"]


def test_round_trip_in_the_plane(tmp_path: Path) -> None:
    walls = {face: Wall("slip") for face in FACES[2]}
    scene = column_collapse(
        domain=(1, 1), length=0.3, height=0.5, gravity=9.81, duration=0.1, material=Material(1, 1, 0, 0), walls=walls
    )
    flat = make_moving(scene, frames=2)
    write_trajectory(tmp_path / "flat.h5", flat)
    assert_same(read_trajectory(tmp_path / "flat.h5"), flat)


def test_the_same_trajectory_is_the_same_bytes(trajectory: Trajectory, path: Path, tmp_path: Path) -> None:
    time.sleep(1.1)  # HDF5 can store times, in seconds
    write_trajectory(tmp_path / "again.h5", trajectory)
    assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()


def test_header_says_what_is_inside(trajectory: Trajectory, path: Path) -> None:
    header = read_header(path)
    assert (header.num_frames, header.num_particles, header.dim) == trajectory.position.shape
    assert (header.dt, header.scene, header.provenance) == (0.01, trajectory.scene, trajectory.provenance)
    assert header.material_features == ("tan_friction_angle",)


def test_static_arrays(trajectory: Trajectory, path: Path) -> None:
    static = read_static(path)
    assert sorted(static) == ["initial_velocity", "mass", "material", "particle_type"]
    for name, array in static.items():
        np.testing.assert_array_equal(array, getattr(trajectory, name))


@pytest.mark.parametrize("chunk_bytes", [1, 1500, 10**6])
def test_windows_are_slices_whatever_the_chunks(
    trajectory: Trajectory, tmp_path: Path, chunk_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gns_pl.io.hdf5, "CHUNK_BYTES", chunk_bytes)
    path = tmp_path / "drop.h5"
    write_trajectory(path, trajectory)
    with h5py.File(path) as file:
        assert file["particles/all/position/value"].chunks[1:] == trajectory.position.shape[1:]
    with open_trajectory(path) as file:
        for start in range(23):
            for length in range(1, 24 - start):
                window = read_window(file, start, length)
                assert window.dtype == np.float32
                np.testing.assert_array_equal(window, trajectory.position[start : start + length])
    np.testing.assert_array_equal(read_window(path, 5, 7), trajectory.position[5:12])


@pytest.mark.parametrize(("start", "length"), [(-1, 3), (0, 0), (0, 24), (22, 2), (30, 1)])
def test_windows_outside_are_refused(path: Path, start: int, length: int) -> None:
    with pytest.raises(InputError, match=r"drop\.h5: frames .* outside its 23 frames"):
        read_window(path, start, length)


def test_every_truncation_is_named(path: Path) -> None:
    whole = path.read_bytes()
    for length in [*range(0, 3000, 61), *range(3000, len(whole), 499), len(whole) - 1]:
        path.write_bytes(whole[:length])
        for read in (read_trajectory, read_header, lambda p: read_window(p, 0, 7)):
            with pytest.raises(InputError, match=r"drop\.h5: is (truncated or damaged|not an HDF5 file)\.$"):
                read(path)
    path.write_bytes(whole)
    assert read_trajectory(path).num_frames == 23


def test_damage_is_named_or_changes_nothing(trajectory: Trajectory, path: Path) -> None:
    """Flipped bits in metadata or arrays never pass for data."""
    whole = path.read_bytes()
    named = 0
    for place in np.random.default_rng(0).integers(0, len(whole), 150):
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            read = read_trajectory(path)
        except InputError as error:
            assert str(error).startswith(f"{path}: ")
            named += 1
        else:
            for name in ("position", "particle_type", "material", "mass", "initial_velocity"):
                np.testing.assert_array_equal(getattr(read, name), getattr(trajectory, name))
    assert named > 100


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89HDF\r\n\x1a\n" + bytes(50)])
def test_foreign_files_are_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "foreign.h5"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"foreign\.h5: is "):
        read_trajectory(path)


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.h5: no such file"):
        read_trajectory(tmp_path / "none.h5")
    with pytest.raises(InputError, match="is not an HDF5 file"):
        read_trajectory(tmp_path)


@pytest.mark.parametrize("name", ["position", "mass", "initial_velocity", "material"])
def test_numbers_that_are_not_finite_are_neither_written_nor_read(
    trajectory: Trajectory, path: Path, name: str
) -> None:
    array = getattr(trajectory, name).copy()
    array[5 if name == "position" else 0, ...] = np.nan
    before = path.read_bytes()
    when = " from frame 5 on" if name == "position" else ""
    with pytest.raises(InputError, match=rf"drop\.h5: {name} holds numbers that are not finite{when}\."):
        write_trajectory(path, replace(trajectory, **{name: array}))
    assert path.read_bytes() == before
    with h5py.File(path, "r+") as file:
        file[gns_pl.io.schema.LOCATION[name]][...] = array
    with pytest.raises(InputError, match=f"{name} holds numbers that are not finite"):
        read_trajectory(path)


def test_errors_of_the_reader_are_not_blamed_on_the_file(path: Path) -> None:
    with pytest.raises(ValueError, match="mine"), open_trajectory(path):
        raise ValueError("mine")


@pytest.mark.parametrize("dim", [2, 3])
def test_observables_come_back_bit_for_bit_and_only_where_they_are_asked_for(
    drop: Scene, tmp_path: Path, dim: int
) -> None:
    walls = {face: Wall("slip") for face in FACES[2]}
    flat = column_collapse(
        domain=(1, 1), length=0.3, height=0.5, gravity=9.81, duration=0.1, material=Material(1, 1, 0, 0), walls=walls
    )
    flow = make_moving(drop if dim == 3 else flat, frames=5, spacing=0.06)
    written = replace(flow, observables=compute_observables(flow, 0.15))
    path = tmp_path / "observed.h5"
    write_trajectory(path, written)
    assert_same(read_trajectory(path), flow)
    stored, alone = read_trajectory(path, observables=True).observables, read_observables(path)
    first = read_trajectory(path, 2, observables=True).observables
    assert written.observables is not None and stored is not None and alone is not None and first is not None
    assert (stored.percents, stored.cell) == (written.observables.percents, 0.15)
    for field in OBSERVED:
        wanted = getattr(written.observables, field.name)
        for observables in (stored, alone):
            assert getattr(observables, field.name).tobytes() == wanted.tobytes()
            assert getattr(observables, field.name).shape == wanted.shape
        np.testing.assert_array_equal(getattr(first, field.name), wanted[:2])
    with h5py.File(path) as file:  # H5MD's elements that are sampled with the positions
        assert file["observables/whole_run/front/time"] == file["particles/all/position/time"]
        assert file["observables/whole_run/volume_map/value"].attrs["unit"] == "m+3"
        assert file["observables/whole_run/volume_map/value"].ndim == 3


def test_a_file_of_version_1_is_read_and_has_no_observables(trajectory: Trajectory, path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = np.int64(1)
    assert_same(read_trajectory(path, observables=True), trajectory)
    assert read_observables(path) is None


def test_observables_that_do_not_fit_are_named(trajectory: Trajectory, tmp_path: Path) -> None:
    observed = replace(trajectory, observables=compute_observables(trajectory, 0.2))
    assert observed.observables is not None
    path = tmp_path / "observed.h5"
    broken = replace(observed.observables, mean_height=np.full(23, np.nan, np.float32))
    with pytest.raises(InputError, match="mean_height holds numbers that are not finite"):
        write_trajectory(path, replace(observed, observables=broken))
    assert not path.exists()
    write_trajectory(path, observed)
    with h5py.File(path, "r+") as file:
        del file["observables/whole_run/front/value"]
        file["observables/whole_run/front/value"] = np.zeros((3, 4), np.float32)
        file["observables/whole_run/front/value"].attrs["unit"] = "m"
    with pytest.raises(InputError, match=r"front/value must be of shape \[T, Q\] with T = 23, not 3"):
        read_trajectory(path)
