"""A third array of geoelements/gns that says nothing of itself: asked for, brought to tan φ, never guessed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gns_pl.convert import convert
from gns_pl.convert.formats import open_set
from gns_pl.convert.given import Given
from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling
from tests.convert.test_convert import ASSUMED


def made(source: Path, target: Path, to: str = "gns_pl", **given: object) -> Path:
    return convert(open_set(source, trust=True), target, to=to, given=Given(**given), assumed=ASSUMED)  # type: ignore[arg-type]


def theirs(folder: Path, value: object) -> Path:
    position = {"train": [falling(8, side=3)]}
    return fixtures.write_geoelements(folder, position, np.full(27, 6), value)


@pytest.mark.parametrize(
    ("value", "meaning"),
    [(np.tan(np.pi / 6), "tan"), (30.0, "degrees"), (np.pi / 6, "radians"), (30 / 70, "phi/70"), (0.5, "phi/60")],
)
def test_every_meaning_is_thirty_degrees(tmp_path: Path, value: float, meaning: str) -> None:
    source = theirs(tmp_path / "theirs", np.full(27, value))
    with pytest.raises(InputError, match=r"means is not stated: give material_value=tan, degrees, radians, phi/70"):
        made(source, tmp_path / "ours")
    assert not (tmp_path / "ours").exists()
    trajectory = read_trajectory(made(source, tmp_path / "ours", material_value=meaning) / "train_0000.h5")
    np.testing.assert_allclose(trajectory.material, 3**-0.5, rtol=1e-6)
    assert trajectory.material_features == ("tan_friction_angle",)
    assert trajectory.scene.materials["sand"].friction_angle_deg == pytest.approx(30, rel=1e-6)


def test_it_may_be_left_out(tmp_path: Path) -> None:
    ours = made(theirs(tmp_path / "theirs", 0.5), tmp_path / "ours", material_value="none")
    trajectory = read_trajectory(ours / "train_0000.h5")
    assert trajectory.material.shape == (27, 0) and trajectory.material_features == ()


@pytest.mark.parametrize(("value", "meaning"), [(2.0, "radians"), (95.0, "degrees"), (30.0, "phi/70"), (-1.0, "tan")])
def test_no_angle_is_told(tmp_path: Path, value: float, meaning: str) -> None:
    with pytest.raises(InputError, match=rf"material value of {value:g} .*give another"):
        made(theirs(tmp_path / "theirs", value), tmp_path / "ours", material_value=meaning)
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]


def test_other_answers_are_refused() -> None:
    for answer in ("sine", "phi/0", "phi/", 70):
        with pytest.raises(InputError, match="material_value must be one of tan, degrees"):
            Given(material_value=answer)  # type: ignore[arg-type]


def test_what_is_exported_says_what_it_is(tmp_path: Path) -> None:
    ours = made(theirs(tmp_path / "theirs", 30.0), tmp_path / "ours", material_value="degrees")
    exported = made(ours, tmp_path / "exported", to="geoelements")
    assert json.loads((exported / "metadata.json").read_text())["material_property"] == "tan_friction_angle"
    back = read_trajectory(made(exported, tmp_path / "back") / "train_0000.h5")
    np.testing.assert_array_equal(back.material, read_trajectory(ours / "train_0000.h5").material)


@pytest.mark.parametrize(("name", "asked"), [("tan_friction_angle", False), ("material", True)])
def test_plain_arrays_by_the_name_of_the_array(tmp_path: Path, name: str, asked: bool) -> None:
    np.savez(tmp_path / "a.npz", position=falling(5, side=3), **{name: 0.5})
    given = {"dt": 0.01, "lower": (0, 0, 0), "upper": (1, 1, 1)}
    if asked:
        with pytest.raises(InputError, match=r"material value of the particles, 0\.5, means is not stated"):
            made(tmp_path / "a.npz", tmp_path / "ours", **given)
        given["material_value"] = "tan"
    trajectory = read_trajectory(made(tmp_path / "a.npz", tmp_path / "ours", **given) / "train_0000.h5")
    np.testing.assert_array_equal(trajectory.material, np.full((27, 1), 0.5, dtype=np.float32))
