"""The scenes of an evaluation, and what is refused."""

from dataclasses import asdict

import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.scene import Wall, write_scene
from gns_pl.scene.definition import FACES
from gns_pl.scene.extent import characteristic_time
from tests.evaluation.made_up import SAND, column

DATA = {
    "gravity": 9.81,
    "material": asdict(SAND),
    "walls": {face: asdict(Wall("friction", 0.385)) for face in FACES[3]},
}
COLUMNS = {"short": {"length": 0.475, "height": 0.38}, "tall": {"length": 0.3, "height": 0.6}}


def build(specifications=COLUMNS, files=None, **changes):
    settings = {
        "files": files,
        "only": None,
        "domain": [1.5, 0.5, 0.7],
        "duration": 6.0,
        "interval": 0.02,
        "data": DATA,
    } | changes
    return build_scenes(specifications, **settings)


def test_columns_take_material_walls_and_gravity_from_the_data() -> None:
    scenes = build()
    tall = scenes["tall"]
    assert list(scenes) == ["short", "tall"]
    assert tall.materials["sand"] == SAND
    assert tall.walls["z-"] == Wall("friction", 0.385)
    assert tall.bodies[0].size == pytest.approx((0.3, 0.5, 0.6))
    assert tall.gravity == (0, 0, -9.81)
    frames = tall.duration / 0.02
    assert frames == pytest.approx(round(frames))
    assert 6 <= tall.duration / characteristic_time(tall) < 6.1


def test_columns_of_data_in_two_dimensions() -> None:
    data = DATA | {"walls": {face: asdict(Wall("slip")) for face in FACES[2]}}
    assert build(data=data)["short"].upper == (1.5, 0.7)


def test_a_scene_of_ones_own(tmp_path) -> None:
    write_scene(column(), tmp_path / "mine.yaml")
    write_scene(column(name="other"), tmp_path / "other.yaml")
    mine, other = (str(tmp_path / f"{name}.yaml") for name in ("mine", "other"))
    assert build(files=[mine, other], data={}) == {"column": column(), "other": column(name="other")}
    assert build(files=mine, data={}) == {"column": column()}
    assert list(build(files=[mine, other], only="other", data={})) == ["other"]
    with pytest.raises(InputError, match="two scenes are called 'column'"):
        build(files=[mine, mine], data={})
    with pytest.raises(InputError, match="scene 'column': frames 99 s apart leave no frame but its start"):
        build(files=[mine], data={}, interval=99.0)
    with pytest.raises(InputError, match="frame_interval, the time between frames, must be a positive number, not 0"):
        build(interval=0.0)
    with pytest.raises(InputError, match=r"nowhere\.yaml: cannot be read"):
        build(files=["nowhere.yaml"])


@pytest.mark.parametrize("only", [["tall"], "tall"])
def test_only_some(only) -> None:
    assert list(build(only=only)) == ["tall"]


@pytest.mark.parametrize(
    ("specifications", "changes", "message"),
    [
        (COLUMNS, {"only": ["talk"]}, "there is no talk; known are short, tall"),
        ({}, {}, "no scene to evaluate"),
        ({"a/b": COLUMNS["tall"]}, {}, "must be a word"),
        ({"x": {"length": 1}}, {}, "length, height"),
        ({"x": {"length": 0.3, "height": 0.9}}, {}, "outside the domain"),
        (COLUMNS, {"duration": -1}, "duration must be positive"),
        (COLUMNS, {"duration": "long"}, "duration must be positive"),
        (COLUMNS, {"data": {"gravity": 9.81}}, "do not state their material, walls"),
        (COLUMNS, {"data": DATA | {"material": {"colour": "red"}}}, "unknown key colour"),
    ],
)
def test_refusals_are_one_sentence(specifications, changes, message) -> None:
    with pytest.raises(InputError, match=message):
        build(specifications, **changes)


def test_a_scene_without_gravity_is_refused_before_it_is_simulated(tmp_path) -> None:
    write_scene(column().replace(gravity=(0, 0, 0)), tmp_path / "space.yaml")
    with pytest.raises(InputError, match="no gravity"):
        build(files=str(tmp_path / "space.yaml"))
