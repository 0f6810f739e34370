"""Runs of CB-Geo MPM as a data set: what each run's deck says is in its own trajectory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gns_pl.convert.facts import find_out
from gns_pl.convert.formats import open_set
from gns_pl.convert.given import Given
from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling
from tests.convert.test_convert import converted

RUNS = {"a": (9.81, 30.0, 1.0), "b": (1.62, 40.0, 2.0)}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    for name, (gravity, friction, size) in RUNS.items():
        position = falling(5, side=3, gravity=gravity).astype(np.float64)
        fixtures.write_cb_geo(tmp_path / "runs" / name, position, columns={"velocity_x": 2.0})
        fixtures.write_deck(tmp_path / "runs" / name, gravity=gravity, frictions={0: friction}, size=size)
    return tmp_path / "runs"


def test_every_trajectory_has_the_box_gravity_and_material_of_its_deck(runs: Path, tmp_path: Path) -> None:
    ours = converted(runs, tmp_path / "ours")
    for file, (gravity, friction, size) in zip(("train_0000", "valid_0000"), RUNS.values(), strict=True):
        trajectory = read_trajectory(ours / f"{file}.h5")
        assert trajectory.scene.gravity == (0.0, 0.0, -gravity) and trajectory.scene.upper == (size,) * 3
        assert trajectory.scene.materials["sand"].friction_angle_deg == pytest.approx(friction, rel=1e-6)
        assert trajectory.scene.materials["sand"].density == 1800
        np.testing.assert_allclose(trajectory.material, np.tan(np.radians(friction)), rtol=1e-6)
        np.testing.assert_array_equal(trajectory.initial_velocity, np.tile([2.0, 0, 0], (27, 1)))
    assert read_manifest(ours).spacing == pytest.approx(0.1, rel=1e-6), "by the volume of a particle"


def test_runs_at_several_places_on_a_map_have_their_own_origins(tmp_path: Path) -> None:
    """They are 100 km apart, where float32 would round to a centimetre; each is near zero in its own box."""
    places = {"a": (600_000.0, 5_100_000.0, 1500.0), "b": (700_000.5, 5_100_000.0, 0.0)}
    for name, corner in places.items():
        fixtures.write_cb_geo(tmp_path / "runs" / name, falling(5, side=3).astype(np.float64) + np.array(corner))
        fixtures.write_deck(tmp_path / "runs" / name, corner=corner)
    ours = converted(tmp_path / "runs", tmp_path / "ours")
    for file, corner in zip(("train_0000", "valid_0000"), places.values(), strict=True):
        trajectory = read_trajectory(ours / f"{file}.h5")
        origin = np.floor(corner)
        assert trajectory.scene.origin == tuple(origin) and trajectory.scene.lower == tuple(corner - origin)
        np.testing.assert_allclose(trajectory.position, falling(5, side=3) + (corner - origin), atol=2e-7)
    with pytest.raises(InputError, match=r"rounded to 0\.012, as float32 is there"):
        converted(tmp_path / "runs", tmp_path / "one", lower=(0, 0, 0), upper=(1e6, 1e7, 1e4))


def test_what_the_user_gives_holds_for_all_of_them(runs: Path, tmp_path: Path) -> None:
    ours = converted(runs, tmp_path / "ours", lower=(0, 0, 0), upper=(3, 3, 3), gravity=5.0)
    for file in ("train_0000", "valid_0000"):
        scene = read_trajectory(ours / f"{file}.h5").scene
        assert scene.upper == (3.0,) * 3 and scene.gravity == (0.0, 0.0, -5.0)


def test_a_volume_of_something_else_is_asked_about(tmp_path: Path) -> None:
    fixtures.write_cb_geo(tmp_path, falling(5, side=4).astype(np.float64), columns={"volume": 1.0})
    fixtures.write_deck(tmp_path)
    with pytest.raises(InputError, match=r"the stated spacing, 1, does not fit particles 0\.\d+ apart: give spacing=…"):
        converted(tmp_path, tmp_path.parent / "ours")


def test_runs_of_other_spacings_are_asked_about(tmp_path: Path) -> None:
    for name, volume in (("a", 1e-3), ("b", 2e-3)):
        fixtures.write_cb_geo(tmp_path / name, falling(5, side=3).astype(np.float64), columns={"volume": volume})
    fixtures.write_deck(tmp_path)
    findings = find_out(open_set(tmp_path), Given())
    assert findings.asks == ("its spacings are 0.1 to 0.125992: convert those of one spacing alone, or give spacing=…",)
    facts = find_out(open_set(tmp_path), Given(spacing=0.1)).facts
    assert facts is not None and facts.spacing == 0.1
