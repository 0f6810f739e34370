"""Random ground: what is drawn lies within what its family says, so that a range can be told from the family alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Box, Wall, fill_scene, sample_ground_release
from gns_pl.scene.definition import FACES
from gns_pl.scene.ground_release import ground_limits
from gns_pl.solvers.training_range import out_of_range
from tests.conftest import SAND

FAMILY: dict[str, Any] = {
    "domain": [1.6, 0.7, 0.95],
    "length": [0.25, 0.4],
    "height": [0.12, 0.35],
    "duration": 1.0,
    "incline_deg": [0.0, 30.0],
    "friction": [0.2, 0.7],
    "hill": 0.08,
    "step": 0.3,
    "barrier": 0.5,
}
WALLS = dict.fromkeys(FACES[3], Wall("friction", 0.385))


def draw(seed: int, **changes: Any) -> Any:
    family = {**FAMILY, **changes}
    return sample_ground_release(np.random.default_rng(seed), **family, gravity=9.81, material=SAND, walls=WALLS)


DATA = {
    "gravity": 9.81,
    "material": {name: getattr(SAND, name) for name in vars(SAND)},
    "walls": {face: {"condition": "friction", "friction": 0.385} for face in FACES[3]},
    "families": {
        "ground": {"kind": "ground_release", "count": 1, **FAMILY},
        "columns": {"kind": "column_collapse", "count": 1, "length": [0.2, 0.5], "aspect_ratio": [0.4, 4.0]},
    },
}


def test_what_is_drawn_is_in_range() -> None:
    scenes = [draw(seed) for seed in range(40)]
    assert scenes[3] == draw(3)
    for scene in scenes:
        assert next(out_of_range(scene, DATA), None) is None
        assert len(fill_scene(scene, 0.04).position) > 100
        assert scene.terrain.heights.min() == pytest.approx(0.02)
        assert scene.walls["y-"] in (Wall("slip"), scene.terrain.wall)
    cuboids = [len([each for each in scene.obstacles if isinstance(each, Box)]) for scene in scenes]
    assert set(cuboids) == {0, 1, 2}


def test_layers_follow_the_ground_and_valleys_rise() -> None:
    """Neither changes what else is drawn: the same block, hills and friction with and without them."""
    scenes, plain = [
        [draw(seed, step=0.0, **more) for seed in range(12)]
        for more in ({"layer": 1.0, "far_incline_deg": [10.0, 20.0], "curve": [0.05, 0.3]}, {"curve": [0.05, 0.3]})
    ]
    for scene, other in zip(scenes, plain, strict=True):
        body, block = scene.bodies[0], other.bodies[0]
        assert (body.position[:2], scene.terrain.wall) == (pytest.approx(block.position[:2]), other.terrain.wall)
        filled = fill_scene(scene, 0.04).position
        above = filled[:, 2] - scene.terrain.height(filled[:, :2])
        assert above.min() > 0 and above.max() < body.thickness <= 0.35
        rise = scene.terrain.heights - other.terrain.heights
        assert np.degrees(np.arctan(np.diff(rise, axis=0).max() / scene.terrain.cell)) == pytest.approx(14, abs=6)
        assert next(out_of_range(scene, {**DATA, "families": {"ground": {**DATA["families"]["ground"], "layer": 1.0,
            "far_incline_deg": [10.0, 20.0], "curve": [0.03, 0.3]}}}), None) is None  # fmt: skip


def test_what_is_beyond_is_told() -> None:
    """Steeper, rougher and slipperier ground than the family's, and walls that stick."""
    scene = draw(1, step=0.0, barrier=0.0)
    steep, bend = ground_limits(FAMILY)
    spiky = scene.terrain.heights.copy()
    spiky[-5, 10] += 0.2
    for changed, words in (
        (scene.replace(terrain=scene.terrain.replace(heights=spiky)), "trained on ground of up to 47°, not 7"),
        (scene.replace(terrain=scene.terrain.replace(heights=spiky)), "whose slope changes by up to 13 in a metre"),
        (scene.replace(terrain=scene.terrain.replace(wall=Wall("friction", 0.1))), "of friction 0.2 to 0.7, not"),
        (scene.replace(walls={**scene.walls, "y-": Wall("stick")}), "of friction 0.2 to 0.7, not stick"),
    ):
        reasons = " ".join(out_of_range(changed, DATA))
        assert words in reasons
    columns = {**DATA, "families": {"columns": DATA["families"]["columns"]}}  # type: ignore[index]
    assert "takes no terrain" in next(out_of_range(scene, columns))
    assert (round(steep), round(bend)) == (47, 13)


def test_ranges_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match=r"ground releases: lengths must fit .* and inclines lie between 0 and 60°"):
        draw(0, incline_deg=[20.0, 70.0])
    with pytest.raises(InputError, match=r"the block reaches up to .* m, above the domain"):
        draw(0, domain=[1.6, 0.7, 0.2])
