"""Terrains by a formula: as steep as they say, and the same from a scene file as from the formula."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Terrain, Wall, read_scene
from gns_pl.scene.ground import terrain_from_dict
from gns_pl.scene.shapes import shaped_raster

WALL = {"condition": "friction", "friction": 0.3}
SLOPE: dict[str, Any] = {
    "shape": "slope", "size": [4.0, 1.0], "cell": 0.05, "slope_deg": 30.0, "toe": [1.5, 0.5], "runout_deg": 4.0,
}  # fmt: skip


def terrain(**changes: Any) -> Terrain:
    return terrain_from_dict({**SLOPE, "wall": WALL, **changes}, Path())


def test_a_slope_bends_into_its_runout() -> None:
    ground = terrain()
    assert ground.extent == ((0.0, 0.0), (pytest.approx(4.0), pytest.approx(1.0)))
    assert ground.heights.min() == 0.0 and ground.wall == Wall("friction", 0.3)
    line = ground.heights[:, 3]
    angles = np.degrees(np.arctan(-np.diff(line) / 0.05))
    assert angles[:29] == pytest.approx(30.0, abs=2e-3) and angles[41:] == pytest.approx(4.0, abs=2e-3)
    assert (np.diff(angles) < 3e-3).all() and np.ptp(ground.heights, axis=1).max() == 0.0


def test_a_gully_is_as_deep_as_it_says_and_ends_with_the_bend() -> None:
    plain, deep = terrain(), terrain(gully=[0.2, 0.8])
    dip = (plain.heights - plain.heights[0, 0]) - (deep.heights - deep.heights[0, 0])
    assert dip[:30].max() == pytest.approx(0.2, rel=0.01) and dip[:30, 0].max() == pytest.approx(0.0, abs=1e-6)
    assert np.ptp(dip[42:], axis=1).max() < 1e-6
    swung = terrain(gully=[0.2, 0.8], bend=0.1).heights
    assert swung[10].argmin() != swung[30].argmin() and deep.heights[10].argmin() == deep.heights[29].argmin()


def test_a_mound_stands_where_it_says() -> None:
    x, y = np.meshgrid((np.arange(80) + 0.5) * 0.05, (np.arange(20) + 0.5) * 0.05, indexing="ij")
    rise = terrain(mound=[2.5, 0.4, 0.3, 0.2]).heights - terrain().heights
    assert rise == pytest.approx(0.3 * np.exp(-((x - 2.5) ** 2 + (y - 0.4) ** 2) / 0.2**2), abs=2e-6)


def test_a_bowl_is_round() -> None:
    bowl = {"shape": "bowl", "size": [2.0, 2.0], "cell": 0.05, "slope_deg": 20.0, "centre": [1.0, 1.0], "rounding": 0.1}
    heights = shaped_raster(bowl).values
    assert heights == pytest.approx(heights.T) and heights == pytest.approx(heights[::-1])
    assert np.diff(heights[30:, 19]) / 0.05 == pytest.approx(np.tan(np.radians(20.0)), rel=0.04)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shape": "slop"}, r"shape must be one of slope, bowl, not 'slop' \(did you mean slope\?\)"),
        ({"slope_deg": 70}, "slope_deg must lie within ± 60°, not 70"),
        ({"size": [0.05, 1.0]}, "has no two cells of 0.05 m"),
        ({"cell": None}, "cell must be a number"),
        ({"gully": [0.1]}, "gully must have 2 entries"),
        ({"gulli": [0.1, 1.0]}, r"unknown key gulli \(did you mean gully\?\)"),
        ({"mound": [1.0, 1.0, 0.1, 0.0]}, "mound must be a finite number above 0"),
    ],
)
def test_what_makes_no_terrain_is_told(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        terrain(**changes)


def test_a_shipped_scene_has_other_ground_on_demand() -> None:
    plain, steep = read_scene("runout"), read_scene("runout", {"terrain.slope_deg": 35.0})
    assert plain.terrain is not None and steep.terrain is not None
    assert np.ptp(steep.terrain.heights) > 1.1 * np.ptp(plain.terrain.heights)
