"""Where others' data lie: on a map, outside the box they state, at a spacing that no default fits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.conversion.facts import find_out
from gns_pl.conversion.given import Given
from gns_pl.conversion.sets import advised_radius_of
from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.io.convert import open_set
from tests.conversion.test_convert import BOX, converted, positions, same
from tests.io.convert import fixtures
from tests.io.convert.fixtures import falling

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
