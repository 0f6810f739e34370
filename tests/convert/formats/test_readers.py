from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gns_pl.convert.formats import ForeignSet, open_set
from gns_pl.convert.formats.tfrecord import crc32c, masked
from gns_pl.errors import InputError
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling


def everything(found: ForeignSet, number: int = 0) -> np.ndarray:
    """All frames, read in two blocks."""
    with found.recording(number) as recording:
        middle = recording.num_frames // 2
        return np.concatenate([recording.frames(0, middle), recording.frames(middle, recording.num_frames)])


def test_geoelements_npz(tmp_path: Path) -> None:
    position = {"train": [falling(), falling(7, seed=1)], "test": [falling(seed=2)]}
    types = np.full(64, 6)
    types[:3] = 3
    fixtures.write_geoelements(tmp_path, position, types, np.float64(0.5))
    found = open_set(tmp_path, trust=True)
    assert [split for split, _ in found.names] == ["train", "train", "test"]
    assert found.stated.dt == 0.01 and found.stated.upper == (1.0, 1.0, 1.0) and found.stated.radius == 0.15
    np.testing.assert_array_equal(everything(found, 1), position["train"][1])
    with found.recording(2) as recording:
        np.testing.assert_array_equal(recording.particle_type, types)
        np.testing.assert_array_equal(recording.material, np.full((64, 1), 0.5, dtype=np.float32))
        assert recording.moved.sum() == 61


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_pickles_of_every_protocol(tmp_path: Path, protocol: int) -> None:
    position = falling()
    row = fixtures.objects(position, 6)
    fixtures.write_zip(tmp_path / "train.npz", {"a": fixtures.pickled_npy(row, row.shape, protocol)})
    found = open_set(tmp_path / "train.npz", trust=True)
    np.testing.assert_array_equal(everything(found), position)


def test_arrays_that_numpy_itself_saved(tmp_path: Path) -> None:
    position = np.asfortranarray(falling().astype(">f8"))
    rows = np.empty((2, 2), dtype=object)
    for number in range(2):
        rows[number, 0], rows[number, 1] = position + number, np.full(64, 5, dtype=np.int32)
    np.savez_compressed(tmp_path / "test.npz", gns_data=rows)
    found = open_set(tmp_path / "test.npz", trust=True)
    assert [split for split, _ in found.names] == ["test", "test"]
    np.testing.assert_array_equal(everything(found, 1), position + 1)


def test_a_structured_array_needs_no_trust(tmp_path: Path) -> None:
    position = falling()
    kind = [("positions", "f4", position.shape), ("particle_type", "i8", (64,))]
    data = np.zeros(1, dtype=kind)
    data["positions"][0], data["particle_type"][0] = position, 6
    np.savez(tmp_path / "train.npz", gns_data=data)
    np.testing.assert_array_equal(everything(open_set(tmp_path / "train.npz")), position)


def test_geoelements_hdf5(tmp_path: Path) -> None:
    position = [falling(), falling(seed=1)]
    fixtures.write_geoelements_hdf5(tmp_path / "train.h5", position, np.full(64, 6), 0.7)
    found = open_set(tmp_path)
    assert found.kind == "geoelements/gns" and len(found.names) == 2 and found.stated.dt is None
    np.testing.assert_array_equal(everything(found, 1), position[1])


def test_lagrangebench_and_its_walls(tmp_path: Path) -> None:
    types = np.zeros(64, dtype=np.int64)
    types[:4], types[4:6] = 1, 2
    fixtures.write_lagrangebench(tmp_path, {"train": [falling()], "valid": [falling(seed=1)]}, types)
    found = open_set(tmp_path)
    assert found.kind == "LagrangeBench" and found.stated.spacing == 0.1
    assert found.stated.dt == pytest.approx(0.01), "a frame is write_every solver steps"
    with found.recording(0) as recording:
        assert recording.particle_type[:6].tolist() == [3] * 6 and set(recording.particle_type[6:]) == {5}
    np.testing.assert_array_equal(everything(found, 1), falling(seed=1))


def test_tfrecord(tmp_path: Path) -> None:
    position = [falling(dim=2), falling(5, dim=2, seed=3)]
    fixtures.write_tfrecord(tmp_path / "train.tfrecord", position, np.full(16, 5), step_context=True)
    fixtures.write_metadata(tmp_path, bounds=[[0.1, 0.9], [0.1, 0.9]], dim=2)
    found = open_set(tmp_path)
    assert found.stated.lower == (0.1, 0.1)
    np.testing.assert_array_equal(everything(found, 1), position[1])
    with found.recording(0) as recording:
        assert "step_context" in recording.notes[0] and recording.dim == 2


def test_crc32c_is_castagnolis() -> None:
    assert crc32c(b"123456789") == 0xE3069283  # the check value of its catalogue entry
    assert crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, B.4
    content = bytes(range(256))
    assert crc32c(content) == fixtures.slow_crc32c(content)
    assert struct.pack("<I", masked(crc32c(content))) == fixtures.record(content)[-4:]


def test_cb_geo_by_name_and_id(tmp_path: Path) -> None:
    position = falling(3).astype(np.float64) + 1e-9
    fixtures.write_cb_geo(tmp_path, position, ranks=2)
    fixtures.write_deck(tmp_path)
    found = open_set(tmp_path)
    assert found.stated.dt == pytest.approx(0.01) and found.stated.gravity == (0.0, 0.0, -9.81)
    assert found.stated.density == 1800 and found.stated.lower == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(everything(found), position)
    with found.recording(0) as recording:
        np.testing.assert_allclose(recording.initial_velocity, np.tile([1.0, 2.0, 3.0], (64, 1)), rtol=1e-12)
        np.testing.assert_allclose(recording.material, np.tan(np.pi / 6), rtol=1e-6)


def test_cb_geo_in_two_dimensions(tmp_path: Path) -> None:
    plane = falling(3, dim=2).astype(np.float64)
    position = np.concatenate([plane, np.zeros((3, 16, 1))], axis=2)
    fixtures.write_cb_geo(tmp_path, position)
    np.testing.assert_array_equal(everything(open_set(tmp_path)), plane)


def test_cb_geo_with_fewer_and_fewer_particles(tmp_path: Path) -> None:
    position = falling(3).astype(np.float64)
    fixtures.write_cb_geo(tmp_path, position, lost=[5, 9])
    with pytest.raises(InputError, match="2 of 64 particles left the mesh"):
        everything(open_set(tmp_path))
    kept = np.delete(np.arange(64), [5, 9])
    np.testing.assert_array_equal(everything(open_set(tmp_path, lost="drop")), position[:, kept])


def test_cb_geo_with_files_that_are_missing(tmp_path: Path) -> None:
    fixtures.write_cb_geo(tmp_path, falling(5).astype(np.float64), ranks=2)
    (tmp_path / "particles-1_2-00010.h5").unlink()
    with pytest.raises(InputError, match="step 10 lacks the files of some ranks"):
        open_set(tmp_path)
    (tmp_path / "particles-0_2-00010.h5").unlink()
    with pytest.raises(InputError, match="do not follow evenly"):
        open_set(tmp_path)


def test_plain_arrays(tmp_path: Path) -> None:
    for split in ("train", "valid"):
        (tmp_path / split).mkdir()
    position = falling()
    (tmp_path / "train/a.npy").write_bytes(fixtures.npy_bytes(position))
    np.savez(tmp_path / "valid/b.npz", positions=position + 1, particle_type=np.full(64, 3), tan_friction_angle=0.4)
    found = open_set(tmp_path)
    assert sorted(found.names) == [("train", "train/a.npy"), ("valid", "valid/b.npz")]
    np.testing.assert_array_equal(everything(found, 0), position)
    with found.recording(1) as recording:
        assert not recording.moved.any() and recording.material_features == ("tan_friction_angle",)


@pytest.mark.parametrize("dt", [0.01, None])
def test_vtk_as_text(tmp_path: Path, dt: float | None) -> None:
    position = falling(12)  # so that _10 has to come behind _9
    fixtures.write_vtk(tmp_path, position, dt=dt)
    found = open_set(tmp_path)
    assert found.stated.dt == (None if dt is None else pytest.approx(dt))
    np.testing.assert_array_equal(everything(found), position)


@pytest.mark.parametrize("mode", ["ascii", "binary", "appended", "zlib", "zlib appended", "big lengths"])
def test_vtk_as_vtk_writes_it(tmp_path: Path, mode: str) -> None:
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    position = falling(2)
    for frame, places in enumerate(position):
        points, mesh, writer = vtkPoints(), vtkPolyData(), vtk.vtkXMLPolyDataWriter()
        points.SetData(numpy_to_vtk(places, deep=True))
        mesh.SetPoints(points)
        writer.SetInputData(mesh)
        writer.SetFileName(str(tmp_path / f"p{frame}.vtp"))
        writer.SetDataModeToAppended() if "appended" in mode else writer.SetDataModeToBinary()
        writer.SetBlockSize(512)
        if mode == "ascii":
            writer.SetDataModeToAscii()
        if "zlib" not in mode:
            writer.SetCompressorTypeToNone()
        if mode == "big lengths":
            writer.SetHeaderTypeToUInt64()
        writer.Write()
    np.testing.assert_array_equal(everything(open_set(tmp_path)), position)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda folder: None, "holds none of the formats that are known"),
        (lambda folder: (folder / "a.npy").write_bytes(b"hello"), "is not an array in NumPy's format"),
        (lambda folder: np.save(folder / "a.npy", np.zeros((3, 4))), r"positions must be \[T, N, D\], not \[3, 4\]"),
        (lambda folder: np.save(folder / "a.npy", np.zeros((3, 4, 3), dtype=int)), "must be floating-point numbers"),
        (lambda folder: np.save(folder / "a.npy", np.zeros((3, 4, 5))), "5 components"),
        (lambda folder: np.save(folder / "a.npy", np.full((3, 4, 2), np.nan)), "not finite from frame 0 on"),
        (lambda folder: np.save(folder / "a.npy", np.zeros((3, 0, 2))), "is empty"),
        (lambda folder: np.save(folder / "a.npy", np.array([{}], dtype=object)), "pickled Python objects"),
    ],
)
def test_what_cannot_be_used_is_told_in_a_sentence(
    tmp_path: Path, make: Callable[[Path], object], sentence: str
) -> None:
    make(tmp_path)
    with pytest.raises(InputError, match=sentence) as caught:
        everything(open_set(tmp_path))
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)


def test_vtk_with_a_changing_number_of_particles(tmp_path: Path) -> None:
    fixtures.write_vtk(tmp_path, falling(3))
    (tmp_path / "run_1.vtp").write_bytes(fixtures.vtp(falling()[0][:-1]))
    with pytest.raises(InputError, match=r"run_1\.vtp has 63 particles and the first file 64"):
        everything(open_set(tmp_path))


def test_a_tfrecord_with_a_changing_number_of_particles(tmp_path: Path) -> None:
    frames = [frame.tobytes() for frame in falling(3)]
    example = fixtures.sequence_example([*frames[:2], frames[2][:-12]], np.full(64, 6).tobytes())
    (tmp_path / "train.tfrecord").write_bytes(fixtures.record(example))
    with pytest.raises(InputError, match=r"frame 2 has .* the number of particles must not change"):
        everything(open_set(tmp_path))
