"""What an ensemble varies: friction, release, and the values it takes."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Plane, Raster, Release, Scene, Terrain, Wall, make_release
from gns_pl.scene.variation import (
    drawn_values,
    grid_values,
    with_friction_angle,
    with_ground_friction,
    with_release,
)
from tests.evaluation.made_up import column

SQUARE = (((0.2, 0.2), (0.6, 0.2), (0.6, 0.4), (0.2, 0.4)),)


def on_terrain(thickness: float | Raster) -> Scene:
    heights = np.add.outer(0.2 - 0.1 * np.arange(15) / 15, np.zeros(5))
    terrain = Terrain(heights, (0.05, 0.05), 0.1, Wall("friction", 0.5))
    release = make_release(terrain, thickness=thickness, outline=() if isinstance(thickness, Raster) else SQUARE)
    return column().replace(terrain=terrain, bodies=(release,))


def test_friction_of_the_material_and_of_the_ground() -> None:
    assert with_friction_angle(column(), 25.0).materials["sand"].friction_angle_deg == 25.0
    rough = Wall("friction", 0.4)
    scene = on_terrain(0.1)
    scene = scene.replace(walls={**scene.walls, "x-": rough}, obstacles=(Plane((1.5, 0, 0), (-1.0, 0, 1.0), rough),))
    changed = with_ground_friction(scene, 0.7)
    assert changed.terrain is not None and changed.terrain.wall.friction == changed.obstacles[0].wall.friction == 0.7
    assert changed.walls == scene.walls  # the floor slips, and x- is no ground
    with pytest.raises(InputError, match="nothing that scene 'column' stands on has a coefficient"):
        with_ground_friction(column(), 0.7)


@pytest.mark.parametrize("thickness", [0.1, Raster(np.full((4, 2), 0.1), (0.25, 0.25), 0.1)])
def test_a_release_of_so_many_times_the_volume(thickness: float | Raster) -> None:
    for scene in (column(), on_terrain(thickness)):
        for factor in (0.5, 1.5):
            [before], [after] = scene.bodies, with_release(scene, factor).bodies
            assert after.volume == pytest.approx(factor * before.volume, rel=1e-12)
            assert after.position[:2] == pytest.approx(before.position[:2]) and isinstance(after, type(before))
            if isinstance(before, Release):
                assert after.upper[-1] == pytest.approx(before.upper[-1] + (factor - 1) * 0.1)
    with pytest.raises(InputError, match="release must be a finite number above 0"):
        with_release(column(), -1.0)
    with pytest.raises(InputError, match="outside the domain"):
        with_release(column(), 9.0)


def test_more_draws_begin_with_the_fewer_ones_and_fill_the_bands() -> None:
    bands = {"release": (0.5, 1.5), "friction_angle_deg": (25.0, 35.0)}
    drawn = drawn_values(bands, 64, seed=3)
    assert drawn[:7] == drawn_values(bands, 7, seed=3) and drawn != drawn_values(bands, 64, seed=4)
    for key, (low, high) in bands.items():
        values = np.sort([(each[key] - low) / (high - low) for each in drawn])
        np.testing.assert_allclose(values, (np.arange(64) + 0.5) / 64, atol=0.05)  # evenly, and inside


def test_a_grid_has_all_combinations() -> None:
    found = grid_values({"a": (0.0, 1.0), "b": (10.0, 30.0)}, 3)
    assert len(found) == 9 and found[0] == {"a": 0.0, "b": 10.0} and found[5] == {"a": 0.5, "b": 30.0}
