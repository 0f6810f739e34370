"""Where others' data lie: on a map, outside the box they state, at a spacing that no default fits."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.convert.facts import Facts, find_out, near_box
from gns_pl.convert.formats import Stated, open_set
from gns_pl.convert.given import Given
from gns_pl.convert.sets import advised_radius_of
from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.scene import Body, Box, Plane, Wall
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling
from tests.convert.test_convert import BOX, converted, positions, same
from tests.convert.test_own_sets import a_flight, a_scene, write_ours

MAP = np.array([600_000.0, 5_100_000.0, 1500.0])
FAR = {"lower": tuple(MAP.tolist()), "upper": tuple((MAP + 1).tolist())}


@pytest.fixture
def on_map(tmp_path: Path) -> Path:
    """Three trajectories in float64, at a place on a map."""
    folder = tmp_path / "map"
    folder.mkdir()
    for number in range(3):
        np.save(folder / f"{number}.npy", falling(8, seed=number).astype(np.float64) + MAP)
    return folder


def theirs(folder: Path, **metadata: Any) -> Path:
    """A set of geoelements/gns with changes to its metadata; what is None is left out."""
    fixtures.write_geoelements(folder, {"train": [falling(8)], "valid": [falling(8, seed=1)]})
    fixtures.write_metadata(folder, **metadata)
    return folder


def test_what_lies_on_a_map_is_imported_as_at_zero(on_map: Path, tmp_path: Path) -> None:
    """Free fall stays 9.81 m/s² to the digits of float32 near zero; at 5 100 km these would be half a metre apart."""
    folder = converted(on_map, tmp_path / "ours", dt=0.01, **FAR)
    trajectory, scene = (read := read_trajectory(folder / "train_0000.h5")), read.scene
    np.testing.assert_allclose(trajectory.position, falling(8), atol=1e-7)
    fall = trajectory.acceleration()
    np.testing.assert_allclose(fall, np.broadcast_to([0, 0, -9.81], fall.shape), atol=0.02)
    assert scene.origin == tuple(MAP) and scene.lower == (0.0, 0.0, 0.0) and scene.upper == (1.0, 1.0, 1.0)
    manifest = read_manifest(folder)
    assert manifest.spec["imported"]["origin"] == MAP.tolist() and manifest.spacing == pytest.approx(0.1, rel=0.25)
    assert manifest.spec["gravity"] == pytest.approx(9.81, rel=0.01)  # seen in the motion, not asked for


def test_the_map_comes_back_where_coordinates_leave(on_map: Path, tmp_path: Path) -> None:
    """VTK has the map's coordinates in float64; formats that are read as float32 keep the origin beside them."""
    ours = converted(on_map, tmp_path / "ours", dt=0.01, **FAR)
    shown = converted(ours, tmp_path / "vtk", to="vtk")
    np.testing.assert_allclose(positions(shown)["train"][0], falling(8).astype(np.float64) + MAP, atol=2e-7, rtol=0)
    back = converted(shown, tmp_path / "back", **FAR)
    same(positions(back), positions(ours))
    for to in ("geoelements", "lagrangebench"):
        theirs = converted(ours, tmp_path / to, to=to)
        assert json.loads((theirs / "metadata.json").read_text())["origin"] == MAP.tolist()
        same(positions(theirs), positions(ours))
        again = converted(theirs, tmp_path / f"back_{to}")
        same(positions(again), positions(ours))
        assert read_trajectory(again / "train_0000.h5").scene.origin == tuple(MAP)
    twice = converted(ours, tmp_path / "twice")
    assert read_trajectory(twice / "train_0000.h5").scene.origin == tuple(MAP)


def test_axes_and_unit_of_an_origin_are_ours(tmp_path: Path) -> None:
    """Gravity along y, in centimetres: the origin of x, y, z becomes that of z, x, y in whole metres."""
    data = falling(8)[:, :, [1, 2, 0]].astype(np.float64) * 100 + 100 * MAP
    np.save(tmp_path / "turned.npy", data)
    box = {"lower": tuple(100 * MAP), "upper": tuple(100 * MAP + 100)}
    ours = converted(tmp_path / "turned.npy", tmp_path / "ours", dt=0.01, scale=0.01, **box)
    trajectory = read_trajectory(ours / "train_0000.h5")
    assert trajectory.scene.origin == (1500.0, 600_000.0, 5_100_000.0)
    np.testing.assert_allclose(trajectory.position, falling(8), atol=2e-7)


def test_float32_on_a_map_is_told_to_be_lost(tmp_path: Path) -> None:
    """Whatever type it is stored in now: every coordinate is a number of float32."""
    np.save(tmp_path / "lost.npy", (falling(8) + MAP).astype(np.float32).astype(np.float64))
    with pytest.raises(InputError, match=r"coordinates up to 5\.1e\+06 are rounded to 0\.61, as float32 is there, for"):
        converted(tmp_path / "lost.npy", tmp_path / "ours", dt=0.01, spacing=0.1, gravity_axis="z", gravity=9.81, **FAR)
    assert not (tmp_path / "ours").exists()


def test_the_box_that_is_asked_for_has_its_digits(on_map: Path) -> None:
    asked = " ".join(find_out(open_set(on_map), Given(dt=0.01)).asks)
    assert "between [600000.29" in asked and "5100000.29" in asked and "gravity_axis" not in asked


def test_a_box_that_leaves_out_half_is_refused_with_the_number(tmp_path: Path) -> None:
    """Four layers at x = 0.3, 0.4, 0.5 and 0.6 m: two of them are beyond 0.42 m by more than a spacing of 0.05 m."""
    source = theirs(tmp_path / "theirs", bounds=[[0, 0.42], [0, 1], [0, 1]])
    with pytest.raises(InputError, match=r"32 of 64 particles \(50 %\) lie outside the box .* give lower=… upper=…"):
        converted(source, tmp_path / "ours", spacing=0.05)
    assert not (tmp_path / "ours").exists() and not list(tmp_path.glob(".ours*"))
    folder = converted(source, tmp_path / "ours", spacing=0.05, **BOX)
    assert read_trajectory(folder / "train_0000.h5").scene.upper == (1.0, 1.0, 1.0)


def test_every_frame_of_every_trajectory_is_counted(tmp_path: Path) -> None:
    """One that was not looked at beforehand: the seventh of nine has another box than is stated."""
    (tmp_path / "plain").mkdir()
    for number in range(9):
        np.save(tmp_path / f"plain/{number}.npy", falling(8, seed=number) + np.float32(0.6 if number == 6 else 0.0))
    with pytest.raises(InputError, match=r"6\.npy.*: \d+ of 64 particles \(.*\) lie outside the box"):
        converted(tmp_path / "plain", tmp_path / "ours", dt=0.01, spacing=0.1, **BOX)
    assert not (tmp_path / "ours").exists() and not list(tmp_path.glob(".ours*"))


@pytest.mark.parametrize(("stated", "radius"), [(None, 0.21), (0.15, 0.15), (0.004, 0.21)])
def test_the_radius_to_train_with(tmp_path: Path, stated: float | None, radius: float) -> None:
    """The source's, if it reaches anybody; else 2.1 spacings."""
    source = theirs(tmp_path / "theirs", default_connectivity_radius=stated)
    folder = converted(source, tmp_path / "ours", spacing=0.1)
    assert advised_radius_of(read_manifest(folder)) == radius


def with_origins(folder: Path, *origins: tuple[float, ...]) -> Path:
    """A set of ours; its trajectories lie at several places on a map, those for training first."""
    flights = [a_flight(a_scene(origin=origin)) for origin in origins]
    return write_ours(folder, {"train": flights[:1], "valid": flights[:1], "test": flights[1:]})


def test_an_origin_of_the_tests_alone_has_a_part_of_its_own(tmp_path: Path) -> None:
    """Trajectories at two places on a map: each keeps its own on every way there and back."""
    near, far = (10.0, 0.0, 0.0), tuple(MAP.tolist())
    ours = with_origins(tmp_path / "ours", near, far)
    again = converted(ours, tmp_path / "again")
    assert [read_trajectory(again / f"{name}_0000.h5").scene.origin for name in ("train", "test")] == [near, far]
    theirs = converted(ours, tmp_path / "theirs", to="geoelements")
    metadata = json.loads((theirs / "metadata.json").read_text())
    assert metadata["train"]["origin"] == list(near) and metadata["rollout"]["origin"] == list(far)
    back = converted(theirs, tmp_path / "back", spacing=0.1)
    assert [read_trajectory(back / f"{name}_0000.h5").scene.origin for name in ("train", "test")] == [near, far]
    shown = positions(converted(ours, tmp_path / "vtk", to="vtk"))
    for split, origin in (("train", near), ("test", far)):
        np.testing.assert_allclose(shown[split][0], positions(ours)[split][0].astype(np.float64) + origin, atol=1e-9)


def test_two_origins_that_a_format_has_one_place_for_are_refused(tmp_path: Path) -> None:
    """The boxes near zero are the same, and nobody there could tell where they are."""
    ours = with_origins(tmp_path / "ours", (0.0, 0.0, 0.0), tuple(MAP.tolist()))
    with pytest.raises(InputError, match=r"0002\.h5: its origin is \[600000\.0, .*LagrangeBench has one for"):
        converted(ours, tmp_path / "theirs", to="lagrangebench")
    assert not (tmp_path / "theirs").exists()


def test_a_box_of_one_recording_on_a_map_has_its_own_origin() -> None:
    """Whole metres of its own box; one corner alone is stated beside the other of the set, on the map as well."""
    facts = Facts(dt=0.01, scale=1.0, axes=(0, 1, 2), gravity=(0.0, 0.0, -9.81), spacing=0.1, types={}, notes=(),
                  **near_box(*FAR.values()))  # fmt: skip
    lower, upper = tuple(MAP + 20.25), tuple(MAP + 22.25)
    own = facts.of(Stated(lower=lower, upper=upper))
    assert own.origin == tuple(MAP + 20) and own.lower == (0.25,) * 3 and own.upper == (2.25,) * 3
    higher = facts.of(Stated(upper=upper))
    assert higher.origin == tuple(MAP) and higher.lower == (0.0,) * 3 and higher.upper == (22.25,) * 3
    home = facts.of(Stated(lower=(0.0,) * 3, upper=(1.0,) * 3))
    assert home.origin == (0.0,) * 3 and home.upper == (1.0,) * 3
    given = replace(facts, given=("lower", "upper"))
    assert given.of(Stated(lower=lower, upper=upper)) == given


def test_a_scene_of_ours_that_lies_far_moves_with_its_bodies_and_obstacles(tmp_path: Path) -> None:
    """As sets were made before origins were taken off: 10 m from zero in a box of 1 m."""
    far = a_flight(a_scene(
        lower=(10.25, 0.0, 0.0), upper=(11.25, 1.0, 1.0), bodies=(Body((10.5, 0.3, 0.3), (0.4,) * 3, (0.0,) * 3),),
        obstacles=(Box((10.5, 0.0, 0.0), (0.25, 0.1, 0.1), Wall("slip")),
                   Plane((10.5, 0.0, 0.1), (0.0, 0.0, 1.0), Wall("slip"))),
    ))  # fmt: skip
    ours = write_ours(tmp_path / "ours", {"train": [far], "valid": [far]})
    moved = read_trajectory(converted(ours, tmp_path / "moved") / "train_0000.h5")
    scene = moved.scene
    assert scene.origin == (10.0, 0.0, 0.0) and scene.lower[0] == 0.25 and scene.upper[0] == 1.25
    assert scene.bodies[0].position == (0.5, 0.3, 0.3) and scene.bodies[0].size == (0.4,) * 3
    box, plane = scene.obstacles
    assert isinstance(box, Box) and box.position == (0.5, 0.0, 0.0) and box.size == (0.25, 0.1, 0.1)
    assert isinstance(plane, Plane) and plane.point == (0.5, 0.0, 0.1) and plane.normal == (0.0, 0.0, 1.0)
    np.testing.assert_allclose(moved.position, far.position - np.float32([10, 0, 0]), atol=1e-9)


def test_a_box_that_a_recording_states_of_itself_is_asked_about_before_anything_is_written(tmp_path: Path) -> None:
    """One of two trajectories states a box that leaves out the upper layers; a box that is given is that of both."""
    whole = a_flight(a_scene())
    body = Body((0.3,) * 3, (0.1,) * 3, (0.0,) * 3)
    low = replace(whole, scene=whole.scene.replace(upper=(0.45, 1.0, 1.0), bodies=(body,)))
    ours = write_ours(tmp_path / "ours", {"train": [whole], "valid": [low]})
    asks = find_out(open_set(ours), Given(spacing=0.05)).asks
    assert len(asks) == 1 and "32 of 64 particles (50 %) lie outside the box [0.0, 0.0, 0.0] to [0.45, 1.0" in asks[0]
    assert not find_out(open_set(ours), Given(spacing=0.05, **BOX)).asks
