"""Compression by own weight: closed forms, and who is told; frames as far apart as a scene is large."""

from __future__ import annotations

import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Body, Material, Scene, Wall, read_scene
from gns_pl.scene.extent import compression_notice, frame_interval_of, num_frames, own_weight_strain

SAND = Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30)
CLAY = Material(density=1600, youngs_modulus=1e6, poisson_ratio=0.0, friction_angle_deg=20)


def tower(*bodies: Body) -> Scene:
    walls = {face: Wall("slip") for face in ("x-", "x+", "z-", "z+")}
    return Scene("tower", (0, 0), (200, 100), (0, -10), 1.0, {"sand": SAND, "clay": CLAY}, bodies, walls)


def test_a_body_carries_half_of_itself_and_all_that_stands_on_it() -> None:
    modulus = 2e6 * 0.7 / (1.3 * 0.4)
    assert SAND.oedometric_modulus == pytest.approx(modulus)
    alone = tower(Body((0, 0), (10, 50), (0, 0)))
    assert own_weight_strain(alone, 0) == pytest.approx(1800 * 10 * 50 / (2 * modulus))
    clay, sand, beside = (
        Body((0, 0), (5, 2), (0, 0), "clay"),
        Body((0, 2), (5, 3), (0, 0)),
        Body((5, 2), (5, 9), (0, 0)),
    )
    stack = tower(clay, sand, beside)
    assert own_weight_strain(stack, 0) == pytest.approx((1600 * 10 * 1 + 1800 * 10 * 3) / 1e6)
    assert own_weight_strain(stack, 1) == pytest.approx(1800 * 10 * 1.5 / modulus)


def test_who_sinks_by_more_than_two_per_cent_is_told_which_stiffness_it_needs() -> None:
    assert compression_notice(tower(Body((0, 0), (10, 5), (0, 0)))) is None
    sentence = str(compression_notice(tower(Body((0, 0), (10, 50), (0, 0)))))
    assert (
        "compresses 'sand', 50 m high, by 17 % of its height" in sentence and "youngs_modulus to 1.7e+07 Pa" in sentence
    )
    stiff = Material(density=1800, youngs_modulus=1.7e7, poisson_ratio=0.3, friction_angle_deg=30)
    scene = tower(Body((0, 0), (10, 50), (0, 0)))
    assert compression_notice(scene.replace(materials={"sand": stiff})) is None


@pytest.mark.parametrize(
    ("name", "interval"), [("corner", 0.01), ("slope", 0.01), ("runout", 0.01), ("sheet", 0.01), ("hillside", 0.2)]
)
def test_frames_are_as_far_apart_as_a_scene_is_large_and_a_slide_is_long(name: str, interval: float) -> None:
    assert frame_interval_of(read_scene(name)) == interval


def test_a_large_column_has_as_many_frames_as_a_small_one() -> None:
    small, large = (tower(Body((0, 0), (height, height), (0, 0))) for height in (0.3, 30.0))
    assert frame_interval_of(small) == 0.01 and frame_interval_of(large) == 0.05
    assert frame_interval_of(large.replace(gravity=(0, 0))) == 0.01


def test_a_run_has_its_end_besides_its_start() -> None:
    scene = tower(Body((0, 0), (10, 5), (0, 0)))  # lasts 1 s
    assert [num_frames(scene, interval) for interval in (0.01, 0.4, 0.7, 1.0, 1 + 1e-12)] == [101, 3, 2, 2, 2]
    for interval in (1.01, 1.9, 500.0):
        with pytest.raises(InputError, match=f"frames {interval:g} s apart leave no frame but its start, since it las"):
            num_frames(scene, interval)
    for interval in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="frame_interval, the time between frames, must be a positive number"):
            num_frames(scene, interval)


def test_a_scene_shorter_than_the_usual_time_between_frames_still_has_an_end() -> None:
    scene = tower(Body((0, 0), (0.3, 0.3), (0, 0))).replace(duration=0.003)
    assert frame_interval_of(scene) == 0.003 and num_frames(scene, frame_interval_of(scene)) == 2
