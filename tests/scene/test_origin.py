"""Scenes in coordinates of a map: moved near zero in float64, and where they were is remembered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Box, Plane, Scene, Wall, fill_scene, near_origin, read_scene, scene_from_dict, write_scene
from gns_pl.scene.origin import far_origin, without_origin

MAP = (600_000.0, 5_100_000.0, 0.0)


def at(scene: Scene, origin: tuple[float, ...]) -> Scene:
    """The scene with all its places moved by an origin, as somebody writes it who has a map."""

    def moved(place: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(value + zero for value, zero in zip(place, origin, strict=True))

    obstacles = [
        replace(each, point=moved(each.point))
        if isinstance(each, Plane)
        else replace(each, position=moved(each.position))
        for each in scene.obstacles
    ]
    bodies = tuple(replace(body, position=moved(body.position)) for body in scene.bodies)
    return scene.replace(lower=moved(scene.lower), upper=moved(scene.upper), bodies=bodies, obstacles=tuple(obstacles))


def with_obstacles(scene: Scene) -> Scene:
    rough = Wall("friction", 0.5)
    return scene.replace(
        obstacles=(Plane((0.1, 0.0, 0.1), (0, 0, 1), rough), Box((0.7, 0.1, 0.0), (0.1, 0.1, 0.2), rough))
    )


def test_a_scene_file_on_a_map_is_the_scene_at_zero(drop: Scene, tmp_path: Path) -> None:
    local = with_obstacles(drop)
    write_scene(at(local, MAP), tmp_path / "map.yaml")
    found = read_scene(tmp_path / "map.yaml")
    assert found.origin == MAP
    assert found.replace(origin=()) == local
    np.testing.assert_array_equal(fill_scene(found, 0.05).position, fill_scene(local, 0.05).position)


def test_an_origin_survives_files_and_is_added_up(drop: Scene, tmp_path: Path) -> None:
    scene = drop.replace(origin=(10.0, 20.0, 30.0))
    assert scene_from_dict(scene.to_dict()) == scene
    write_scene(at(scene, MAP), tmp_path / "map.json")
    assert read_scene(tmp_path / "map.json").origin == (600_010.0, 5_100_020.0, 30.0)
    assert "origin" not in drop.to_dict() and drop.origin == (0.0, 0.0, 0.0)


def test_a_box_near_zero_stays_where_it_is(drop: Scene) -> None:
    assert near_origin(drop) is drop
    assert far_origin((-1.0, 3.5, 0.0), (1.0, 4.0, 1.0)) == (0.0, 0.0, 0.0)
    assert far_origin((-1.0, 30.5, -50.2), (1.0, 31.0, -49.8)) == (0.0, 30.0, -51.0)
    assert without_origin((600_000.1, 0.30000000000000004), (600_000.0, 0.0)) == (0.1, 0.30000000000000004)


def test_a_scene_that_float32_cannot_hold_is_refused(drop: Scene) -> None:
    with pytest.raises(InputError, match=r"reach 5\.1e\+06 m, where float32 numbers are 0\.5 m apart, .*near_origin"):
        fill_scene(at(drop, MAP), 0.05)
