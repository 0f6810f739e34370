"""Which VTK files are one trajectory: attributes and ranks in files of their own, frames and times that are missing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.convert.formats import open_set
from gns_pl.errors import InputError
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling
from tests.convert.formats.test_readers import everything

POSITION = falling(5, side=3)


def poly_data(points: np.ndarray, arrays: Mapping[str, np.ndarray], lines: int = 0) -> bytes:
    """Points as text with what they carry; `lines` are claimed to join them."""
    carried = "".join(
        f'<DataArray type="Float64" Name="{name}" NumberOfComponents="{values[0].size}" format="ascii">'
        f"{' '.join(repr(float(value)) for value in values.reshape(-1))}</DataArray>"
        for name, values in arrays.items()
    )
    places = " ".join(repr(float(value)) for value in points.reshape(-1))
    return (
        f'<VTKFile type="PolyData" byte_order="LittleEndian"><PolyData><Piece NumberOfPoints="{len(points)}" '
        f'NumberOfLines="{lines}"><PointData>{carried}</PointData><Points><DataArray type="Float32" '
        f'NumberOfComponents="3" format="ascii">{places}</DataArray></Points></Piece></PolyData></VTKFile>'
    ).encode()


def write_as_cb_geo(folder: Path, position: np.ndarray, *, ranks: int = 1, displaced: bool = True) -> None:
    """geometry, velocities and displacements, each a file a rank and step, and the mesh beside the first step.

    Particles go from one rank to another, and each rank writes its own in an order of its own.
    """
    folder.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(0)
    for frame, points in enumerate(position):
        owner = generator.integers(0, ranks, len(points)) if ranks > 1 else np.zeros(len(points))
        order = generator.permutation(len(points)) if ranks > 1 else np.arange(len(points))
        carried: dict[str, dict[str, np.ndarray]] = {
            "geometry": {},
            "velocities": {"velocities": np.full((len(points), 3), frame + 1.0)},
            "stresses": {"stresses": np.zeros((len(points), 9))},
        }
        if displaced:
            carried["displacements"] = {"displacements": points.astype(float) - position[0]}
        for attribute, arrays in carried.items():
            for rank in range(ranks):
                mine = order[owner[order] == rank]
                middle = f"-{rank}_{ranks}-" if ranks > 1 else ""
                content = poly_data(points[mine], {name: values[mine] for name, values in arrays.items()})
                (folder / f"{attribute}{middle}{frame * 100:04d}.vtp").write_bytes(content)
    (folder / "mesh0000.vtp").write_bytes(poly_data(np.eye(3), {}, lines=3))


def test_a_file_for_each_attribute_is_one_trajectory(tmp_path: Path) -> None:
    write_as_cb_geo(tmp_path / "results", POSITION)
    found = open_set(tmp_path / "results")
    assert [name for _, name in found.names] == ["results"]
    np.testing.assert_array_equal(everything(found), POSITION)
    with found.recording(0) as recording:
        np.testing.assert_array_equal(recording.initial_velocity, np.ones((27, 3)))
    assert any("mesh in" in note and "no particles" in note for note in found.stated.notes)
    assert any("displacements, geometry, stresses, velocities" in note for note in found.stated.notes)


def test_the_deck_of_a_series_is_named(tmp_path: Path) -> None:
    write_as_cb_geo(tmp_path / "results", POSITION)
    deck = fixtures.write_deck(tmp_path, dt=1e-4, frictions={0: 35})
    found = open_set(tmp_path / "results", deck=deck)
    assert found.stated.dt == pytest.approx(0.01) and found.stated.gravity == (0, 0, -9.81)
    with found.recording(0) as recording:
        np.testing.assert_allclose(recording.material, np.tan(np.radians(35)), rtol=1e-6)
    np.savez(tmp_path / "a.npz", position=POSITION)
    with pytest.raises(InputError, match="no runs of CB-Geo MPM and no VTK series of one, to which deck= belongs"):
        open_set(tmp_path / "a.npz", deck=deck)


@pytest.mark.parametrize(("cell", "left_out"), [(12, True), (1, False)])
def test_solids_beside_particles_are_a_mesh(tmp_path: Path, cell: int, left_out: bool) -> None:
    fixtures.write_vtk(tmp_path, POSITION, dt=None)
    places = " ".join(map(str, POSITION[0].reshape(-1)))
    (tmp_path / "ground.vtu").write_text(
        '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="27" NumberOfCells="2"><Points>'
        f'<DataArray type="Float32" NumberOfComponents="3" format="ascii">{places}</DataArray></Points><Cells>'
        f'<DataArray type="UInt8" Name="types" format="ascii">{cell} {cell}</DataArray></Cells></Piece>'
        "</UnstructuredGrid></VTKFile>"
    )
    found = open_set(tmp_path)
    assert len(found.names) == 1 and any("ground in" in note for note in found.stated.notes)
    assert any("mesh" in note for note in found.stated.notes) == left_out


def test_an_attribute_of_some_frames(tmp_path: Path) -> None:
    write_as_cb_geo(tmp_path, POSITION)
    (tmp_path / "velocities0400.vtp").unlink()
    (tmp_path / "stresses0100.vtp").unlink()
    np.testing.assert_array_equal(everything(open_set(tmp_path)), POSITION)


def test_ranks_between_which_particles_move(tmp_path: Path) -> None:
    write_as_cb_geo(tmp_path, POSITION, ranks=3)
    found = open_set(tmp_path)
    assert len(found.names) == 1
    frames = everything(found)
    place = [int(np.abs(POSITION[0] - point).sum(axis=1).argmin()) for point in frames[0]]
    assert sorted(place) == list(range(27))
    np.testing.assert_array_equal(frames, POSITION[:, place])


def test_ranks_that_nothing_tells_apart(tmp_path: Path) -> None:
    write_as_cb_geo(tmp_path, POSITION, ranks=2, displaced=False)
    with pytest.raises(InputError, match=r"in several files, between which particles may move, and nothing tells them"):
        everything(open_set(tmp_path))
    (tmp_path / "geometry-1_2-0200.vtp").unlink()
    with pytest.raises(InputError, match="geometry: frame 200 lacks the files of some of its 2 ranks"):
        open_set(tmp_path)


def test_ids_tell_particles_apart(tmp_path: Path) -> None:
    generator = np.random.default_rng(1)
    for frame, points in enumerate(POSITION):
        order = generator.permutation(27)
        (tmp_path / f"run_{frame}.vtp").write_bytes(poly_data(points[order], {"id": order * 2.0}))
    np.testing.assert_array_equal(everything(open_set(tmp_path)), POSITION)
    (tmp_path / "run_3.vtp").write_bytes(poly_data(POSITION[3], {"id": np.arange(27.0)}))
    with pytest.raises(InputError, match=r"run_3\.vtp: has other particles, by their id, than the first file"):
        everything(open_set(tmp_path))


def test_runs_that_begin_or_go_on_alike_are_several(tmp_path: Path) -> None:
    other = POSITION.copy()
    other[-1] += 0.01
    for name, position in (("a", POSITION), ("b", other), ("c", POSITION)):
        fixtures.write_vtk(tmp_path, position, dt=None, name=name)
    found = open_set(tmp_path)
    assert [name for _, name in found.names] == ["a", "b", "c"]
    np.testing.assert_array_equal(everything(found, 1), other)


@pytest.mark.parametrize(("lacking", "words"), [([2], "2 is"), ([2, 3], "2, 3 are")])
def test_missing_frames_are_named(tmp_path: Path, lacking: list[int], words: str) -> None:
    fixtures.write_vtk(tmp_path, falling(7, side=2), dt=None)
    for number in lacking:
        (tmp_path / f"run_{number}.vtp").unlink()
    with pytest.raises(InputError, match=f"run: its numbers do not follow evenly by 1: {words} missing; put back"):
        open_set(tmp_path)


def test_many_missing_frames_and_frames_in_between(tmp_path: Path) -> None:
    fixtures.write_vtk(tmp_path, falling(3, side=2), dt=None)
    (tmp_path / "run_2.vtp").rename(tmp_path / "run_1000000000.vtp")
    fixtures.write_vtk(tmp_path, falling(2, side=2), dt=None)
    with pytest.raises(InputError, match="by 1: 2, 3, 4, 5, 6 and 999999993 more are missing"):
        open_set(tmp_path)
    for before, after in ((0, 0), (1, 10), (1000000000, 25)):
        (tmp_path / f"run_{before}.vtp").rename(tmp_path / f"run_{after}.vtp")
    with pytest.raises(InputError, match="after 10 comes 25 and not 20"):
        open_set(tmp_path)


def test_series_of_other_strides_are_told(tmp_path: Path) -> None:
    fixtures.write_vtk(tmp_path, falling(3, side=2), dt=None, name="a")
    for number, points in enumerate(falling(3, side=2, seed=1)):
        (tmp_path / f"b_{10 * number}.vtp").write_bytes(fixtures.vtp(points))
    with pytest.raises(InputError, match="its series have different intervals between frames"):
        open_set(tmp_path)


def write_list(folder: Path, entries: list[dict[str, Any]]) -> None:
    tags = "".join("<DataSet " + " ".join(f'{k}="{v}"' for k, v in each.items()) + "/>" for each in entries)
    (folder / "run.pvd").write_text(f'<VTKFile type="Collection"><Collection>{tags}</Collection></VTKFile>')


def test_lists_that_cannot_be_followed(tmp_path: Path) -> None:
    position = falling(5, side=2)
    fixtures.write_vtk(tmp_path, position)
    frames = [{"timestep": 0.01 * frame, "file": f"run_{frame}.vtp"} for frame in range(5)]
    write_list(tmp_path, frames[::-1])
    np.testing.assert_array_equal(everything(open_set(tmp_path)), position)
    write_list(tmp_path, [frame for frame in frames if frame["timestep"] != 0.02])
    with pytest.raises(InputError, match=r"do not follow evenly in time: after 0\.01 s comes 0\.03 s and not 0\.02 s"):
        open_set(tmp_path)
    write_list(tmp_path, [frames[0], {"file": "run_1.vtp"}])
    with pytest.raises(InputError, match="gives 1 of its 2 frames a time"):
        open_set(tmp_path)
    write_list(tmp_path, [frames[0], {**frames[1], "timestep": 0.0}])
    with pytest.raises(InputError, match="lists two files for the time 0"):
        open_set(tmp_path)
    write_list(tmp_path, frames)
    for number in (1, 3):
        (tmp_path / f"run_{number}.vtp").unlink()
    with pytest.raises(InputError, match=r"run\.pvd: lists run_1\.vtp, run_3\.vtp, not there; put back"):
        open_set(tmp_path)


def test_parts_of_a_list(tmp_path: Path) -> None:
    entries = []
    for frame, points in enumerate(POSITION):
        for part, mine in enumerate((np.arange(frame + 5), np.arange(frame + 5, 27))):
            arrays = {"id": mine.astype(float)}
            (tmp_path / f"p{part}_{frame}.vtp").write_bytes(poly_data(points[mine], arrays))
            entries.append({"timestep": 0.01 * frame, "part": part, "file": f"p{part}_{frame}.vtp"})
    write_list(tmp_path, entries)
    found = open_set(tmp_path)
    np.testing.assert_array_equal(everything(found), POSITION)
    assert found.stated.dt == pytest.approx(0.01)


def test_a_frame_alone_in_an_npy_file(tmp_path: Path) -> None:
    for frame, points in enumerate(POSITION):
        (tmp_path / f"{frame}.npy").write_bytes(fixtures.npy_bytes(points))
    with pytest.raises(InputError, match=r"not \[27, 3\]; a file is a trajectory: stack its frames in their order"):
        everything(open_set(tmp_path))
