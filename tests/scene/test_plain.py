"""Scenes go through dicts, YAML and JSON unchanged; files that are no scenes are named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gns_pl.errors import InputError
from gns_pl.scene import (
    FACES,
    Box,
    Material,
    Plane,
    Scene,
    Wall,
    column_collapse,
    read_scene,
    scene_from_dict,
    write_scene,
)


def flat() -> Scene:
    walls = {face: Wall("stick") for face in FACES[2]}
    return column_collapse(
        domain=(1, 0.5),
        length=0.1,
        height=1 / 3,
        gravity=9.81,
        duration=1,
        material=Material(1, 2, 0.1, 20),
        walls=walls,
    )


def with_obstacles(scene: Scene) -> Scene:
    slope = Plane((0, 0, 0.1), (0.3, -0.2, 1), Wall("friction", 0.4))
    return scene.replace(obstacles=(slope, Box((0.7, 0, 0), (0.1, 1, 0.3), Wall("stick"))))


@pytest.mark.parametrize("ending", ["yaml", "json", "yml"])
def test_files_give_the_scene_back(drop: Scene, column: Scene, tmp_path: Path, ending: str) -> None:
    for scene in (drop, column, flat(), with_obstacles(drop)):
        path = tmp_path / f"scene.{ending}"
        write_scene(scene, path)
        assert read_scene(path) == scene


def test_dict_is_plain(drop: Scene) -> None:
    data = drop.to_dict()
    assert json.loads(json.dumps(data)) == data
    assert scene_from_dict(data) == drop
    data = with_obstacles(drop).to_dict()
    assert json.loads(json.dumps(data)) == data
    assert scene_from_dict(data) == with_obstacles(drop)
    assert data["obstacles"][1] == {
        "kind": "box",
        "position": [0.7, 0, 0],
        "size": [0.1, 1, 0.3],
        "wall": {"condition": "stick", "friction": 0},
    }


def test_scenes_of_old_files_have_no_obstacles(drop: Scene) -> None:
    assert scene_from_dict(change(drop.to_dict(), "obstacles", ...)) == drop


def change(data: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    """Set, or with ... remove, what stands at a dotted place."""
    target: Any = data
    *keys, last = [int(key) if key.isdigit() else key for key in place.split(".")]
    for key in keys:
        target = target[key]
    if value is ...:
        del target[last]
    else:
        target[last] = value
    return data


@pytest.mark.parametrize(
    ("place", "value", "sentence"),
    [
        ("colour", "red", "scene: unknown key colour; known are name, lower"),
        ("duration", ..., "scene: missing key duration"),
        ("materials", [], "materials must be a mapping"),
        ("materials.sand", 3, "material 'sand' must be a mapping"),
        ("materials.sand.densty", 3, "material 'sand': unknown key densty"),
        ("materials.sand.density", ..., "material 'sand': missing key density"),
        ("walls.z-", ..., "walls must name the faces"),
        ("walls.z-", "stick", "wall 'z-' must be a mapping"),
        ("walls.z-.mu", 0.1, "wall 'z-': unknown key mu"),
        ("bodies", {"a": 1}, "bodies must be a list"),
        ("bodies.0", 3, "body 0 must be a mapping"),
        ("bodies.0.size", ..., "body 0: missing key size"),
        ("bodies.0.radius", 1, "body 0: unknown key radius"),
        ("bodies.0.size", [0.3, 0.3, -0.3], "size must be positive"),
        ("obstacles", {"a": 1}, "obstacles must be a list"),
        ("obstacles.0", 3, "obstacle 0 must be a mapping"),
        ("obstacles.0.kind", "ball", "obstacle 0: kind must be one of plane, box, not 'ball'"),
        ("obstacles.0.kind", ["box"], "obstacle 0: kind must be one of plane, box"),
        ("obstacles.0.kind", ..., "obstacle 0: kind must be one of plane, box, not None"),
        ("obstacles.0.size", [1, 1, 1], "obstacle 0, a plane: unknown key size; known are point, normal, wall"),
        ("obstacles.1.size", ..., "obstacle 1, a box: missing key size"),
        ("obstacles.1.wall.mu", 0.1, "obstacle 1: wall: unknown key mu"),
        ("obstacles.1.wall", "stick", "obstacle 1: wall must be a mapping"),
    ],
)
def test_refusals_name_the_key_and_the_file(drop: Scene, tmp_path: Path, place: str, value: Any, sentence: str) -> None:
    data = change(with_obstacles(drop).to_dict(), place, value)
    with pytest.raises(InputError, match=sentence):
        scene_from_dict(data)
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=rf"bad\.json: .*{sentence}"):
        read_scene(path)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b"[1, 2]", "a scene must be a mapping"), (b"{", "is not YAML or JSON"), (b"\xff\xfe\xff", "is not YAML or JSON")],
)
def test_files_that_are_no_scenes_are_named(tmp_path: Path, content: bytes, sentence: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"scene\.yaml: {sentence}"):
        read_scene(path)


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read"):
        read_scene(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        read_scene(tmp_path)
