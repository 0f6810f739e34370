"""Dotted keys change the plain form of a scene, at any depth."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from gns_pl.errors import InputError
from gns_pl.scene import read_scene
from gns_pl.scene.changes import changed, changes_label, decoded, encoded

SCENE = Path(__file__).parents[2] / "scenes/two_blocks.yaml"


def test_a_file_with_changes_at_any_depth() -> None:
    wall = {"condition": "slip"}
    changes = {"duration": 2, "gravity": [0, 0, -1.62], "bodies.1.velocity": [1, 0, 0], "walls.x+": wall}
    changes |= {"materials.sand.friction_angle_deg": 35, "walls.z-.friction": 0.5}
    scene, before = read_scene(SCENE, changes), read_scene(SCENE)
    assert scene.duration == 2.0 and scene.gravity == (0.0, 0.0, -1.62)
    assert scene.bodies[1].velocity == (1.0, 0.0, 0.0) and scene.bodies[0] == before.bodies[0]
    assert scene.walls["x+"].condition == "slip" and scene.walls["z-"].friction == 0.5
    assert scene.walls["x-"] == before.walls["x-"] and scene.materials["sand"].friction_angle_deg == 35.0


def test_a_new_entry_of_a_list() -> None:
    body = {"position": [0.4, 0, 0], "size": [0.1, 0.1, 0.1], "velocity": [0, 0, 0]}
    assert len(read_scene(SCENE, {"bodies.2": body}).bodies) == 3
    plane = {"kind": "plane", "point": [0, 0, 0.01], "normal": [0, 0, 1], "wall": {"condition": "slip"}}
    assert read_scene(SCENE, {"obstacles": [plane]}).obstacles[0].kind == "plane"


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("bodis.0.size", "scene.bodis: the scene has no such key (did you mean bodies?); there are name, lower"),
        ("bodies.two.size", "two is no entry of the scene; there are 0 to 1."),
        ("bodies.3", "3 is no entry of the scene; there are 0 to 1."),
        ("duration.x", "duration of the scene is 1.2, which has no parts."),
        ("bodies.0.velocty", "body 0: unknown key velocty (did you mean velocity?); known are position"),
        ("duraton", "unknown key duraton (did you mean duration?)"),
    ],
)
def test_a_key_that_leads_nowhere(key: str, sentence: str) -> None:
    with pytest.raises(InputError) as refused:
        read_scene(SCENE, {key: 1})
    assert sentence in str(refused.value) and "two_blocks.yaml" in str(refused.value)


def test_the_file_itself_stays(tmp_path: Path) -> None:
    data = {"a": {"b": [1, 2]}}
    assert changed(data, {"a.b.0": 5}, "it") == {"a": {"b": [5, 2]}} and data == {"a": {"b": [1, 2]}}


def test_every_key_passes_through_the_grammar() -> None:
    for key in ("duration", "bodies.0.velocity", "walls.x+.friction", "materials.wet sand (1).cohesion", "a.ä=.$"):
        parsed = OverridesParser.create().parse_override(f"++changes.{encoded(key)}=1")
        assert decoded({parsed.key_or_group.removeprefix("changes."): 1}) == {key: 1}


def test_names_carry_the_changes() -> None:
    assert changes_label({"aspect_ratio": 2, "name": "mine"}) == "aspect_ratio_2"
    assert changes_label({"b": 0.5, "a": [1, -0.5, 0]}) == "a_1_-0.5_0_b_0.5"
    labels = {changes_label({"x": [0.1] * 60, "last": last}) for last in (1, 2)}
    assert len(labels) == 2 and all(len(label) < 120 for label in labels)
