"""ParaView series, read back with VTK's own readers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.trajectory import Trajectory
from gns_pl.viz import write_paraview
from tests.evaluation.made_up import column, moved, spreading, standing

pv = pytest.importorskip("pyvista")


def mixed(dim: int) -> Trajectory:
    """A column that spreads, with a kinematic particle, two material features and a velocity at its start."""
    flow = spreading(column(dim), frames=7)
    number = flow.num_particles
    types = flow.particle_type.copy()
    types[3] = ParticleType.KINEMATIC
    return replace(
        flow,
        particle_type=types,
        material=np.stack([np.linspace(0.4, 0.7, number), np.arange(number)], axis=1, dtype=np.float32),
        material_features=("tan_friction_angle", 'odd <name> & "quotes"'),
        initial_velocity=np.full((number, dim), 0.25, dtype=np.float32),
    )


def in_space(vectors: np.ndarray) -> np.ndarray:
    return vectors if vectors.shape[-1] == 3 else np.insert(vectors, 1, 0, axis=-1)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_series_is_the_trajectory(tmp_path: Path, dim: int) -> None:
    flow = mixed(dim)
    path = write_paraview(tmp_path / "new" / "folder", flow, name="flow", reference=spreading(column(dim), frames=9))
    assert path == tmp_path / "new" / "folder" / "flow.pvd"
    reader = pv.PVDReader(path)
    np.testing.assert_allclose(reader.time_values, flow.time, rtol=1e-9)
    velocity = in_space(flow.velocity())
    error = in_space(flow.position.astype(float) - spreading(column(dim), frames=9).position[:7])
    for frame, time in enumerate(reader.time_values):
        reader.set_active_time_value(time)
        points = reader.read()[0]
        assert points.n_points == points.n_verts == flow.num_particles
        assert points.points.dtype == np.float32
        assert np.array_equal(points.points, in_space(flow.position[frame]))
        displacement = in_space(flow.position[frame].astype(float) - flow.position[0])
        np.testing.assert_allclose(points["displacement"], displacement, rtol=1e-6)
        np.testing.assert_allclose(points["velocity"], velocity[frame], rtol=1e-6)
        np.testing.assert_allclose(points["speed"], np.linalg.norm(velocity[frame], axis=1), rtol=1e-6)
        np.testing.assert_allclose(points["error"], error[frame], rtol=1e-6)
        assert np.array_equal(points["mass"], flow.mass)
        assert np.array_equal(points["particle_type"], flow.particle_type)
        for index, feature in enumerate(flow.material_features):
            assert np.array_equal(points[feature], flow.material[:, index])


def test_a_shorter_series_replaces_a_longer_one(tmp_path: Path) -> None:
    write_paraview(tmp_path, standing(frames=9), name="a[1]", reference=standing(frames=9))
    kept = [tmp_path / "a[1]_notes.vtp", tmp_path / "b_00007.vtp"]
    for path in kept:
        path.write_text("mine")
    (tmp_path / ".a[1]_00003.vtp.7-abc.part").write_text("left by a killed run")
    for _ in range(2):
        path = write_paraview(tmp_path, standing(frames=8), name="a[1]", every=3)
        assert sorted(tmp_path.iterdir()) == sorted(
            [path, *kept, *(tmp_path / f"a[1]_{frame:05d}.vtp" for frame in (0, 3, 6))]
        )
        np.testing.assert_allclose(pv.PVDReader(path).time_values, [0, 0.06, 0.12])
        assert "error" not in pv.read(tmp_path / "a[1]_00006.vtp").point_data


def test_a_killed_run_leaves_no_list_and_no_cut_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_paraview(tmp_path, standing(), name="a")
    written = 0

    def killed(path: Path, content: bytes) -> None:
        nonlocal written
        written += 1
        if written == 3:
            raise KeyboardInterrupt
        path.write_bytes(content)

    monkeypatch.setattr("gns_pl.viz.paraview.write_atomically", killed)
    with pytest.raises(KeyboardInterrupt):
        write_paraview(tmp_path, spreading(frames=5), name="a")
    assert not (tmp_path / "a.pvd").exists()
    assert all(pv.read(path).n_points == standing().num_particles for path in tmp_path.glob("*.vtp"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"every": 0}, "every must be at least 1, not 0"),
        ({"name": "a/b"}, "can stand in a file name, not 'a/b'"),
        ({"reference": standing(spacing=0.1)}, "40 particles in 3 dimensions and the trajectory 320 in 3"),
        ({"reference": standing(column(2))}, "particles in 2 dimensions"),
        ({"reference": standing(frames=4)}, "4 frames of 0.02 s and the trajectory 5"),
        ({"reference": standing(dt=0.01)}, "5 frames of 0.01 s"),
    ],
)
def test_what_cannot_be_written_is_said_and_nothing_is(tmp_path: Path, arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        write_paraview(tmp_path / "out", standing(), **{"name": "a", **arguments})
    assert not (tmp_path / "out").exists()


def test_a_particle_that_is_not_finite_is_written_as_it_is(tmp_path: Path) -> None:
    offset = np.zeros((5, standing().num_particles, 3))
    offset[3, 5] = np.nan
    flow = moved(standing(), offset)
    write_paraview(tmp_path, flow, name="a")
    assert np.isnan(pv.read(tmp_path / "a_00003.vtp").points[5]).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_points_are_where_the_scene_came_from(tmp_path: Path, dim: int) -> None:
    """Its origin is added in float64; of float32 half a metre would be left of 5 100 km."""
    flow, origin = mixed(dim), (600_000.25, 5_100_000.0, 1500.0)[-dim:]
    placed = replace(flow, scene=flow.scene.replace(origin=origin))
    write_paraview(tmp_path, placed, name="flow")
    points = np.asarray(pv.read(tmp_path / "flow_00003.vtp").points)
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, in_space(flow.position[3].astype(np.float64) + origin))
