"""The scenes: as many, as varied and as repeatable as is said, in both dimensions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.stress.suite import AXES, HEAP_STEPS, Sand, stress_scenes
from gns_pl.scene import FACES, fill_scene
from gns_pl.scene.extent import characteristic_time, initial_extent
from tests.conftest import SAND

WALL = {"condition": "friction", "friction": 0.385}


def sand(dim: int) -> Sand:
    material = {**vars(SAND)}
    return Sand.of({"gravity": 9.81, "material": material, "walls": dict.fromkeys(FACES[dim], WALL)}, dim, 0.02)


@pytest.mark.parametrize("dim", [2, 3])
def test_at_least_a_hundred_scenes_along_twelve_axes_that_can_be_filled(dim: int) -> None:
    scenes = list(stress_scenes(sand(dim), 5))
    assert len(scenes) >= 100 and len(AXES) == 12
    assert {each.axis for each in scenes} == set(AXES)
    assert len({each.scene.name for each in scenes}) == len(scenes)
    for each in scenes:
        particles = fill_scene(each.scene, 0.05 * each.coarseness)
        assert len(particles.position) >= 8, each.scene.name
        assert each.scene.duration / 0.02 == pytest.approx(round(each.scene.duration / 0.02))


def test_the_list_depends_on_the_seed_alone() -> None:
    one, same, other = (list(stress_scenes(sand(2), seed)) for seed in (5, 5, 6))
    assert one == same
    assert [each.axis for each in one] == [each.axis for each in other]
    assert one != other


def test_each_axis_reaches_as_far_as_it_should() -> None:
    by_axis = {axis: [each for each in stress_scenes(sand(2), 5) if each.axis == axis] for axis in AXES}
    taus = [each.scene.duration / characteristic_time(each.scene) for each in by_axis["horizon"]]
    assert min(taus) >= 24
    ratios = [np.divide(*initial_extent(each.scene)[::-1]) for each in by_axis["aspect_ratio"]]
    assert min(ratios) == pytest.approx(0.4) and max(ratios) == pytest.approx(6)
    counts = [len(fill_scene(each.scene, 0.02 * each.coarseness).position) for each in by_axis["count"][:4]]
    usual = len(fill_scene(by_axis["count"][0].scene, 0.02).position)
    assert counts[0] / usual == pytest.approx(0.25, rel=0.1) and counts[3] / usual == pytest.approx(4, rel=0.1)
    assert {each.coarseness for each in by_axis["spacing"]} == {0.8, 0.9, 1.1, 1.2}
    assert all(round(each.scene.duration / 0.02) == HEAP_STEPS for each in by_axis["heap"])
    tilts = [math.degrees(math.atan2(s.scene.gravity[0], -s.scene.gravity[-1])) for s in by_axis["tilt"]]
    assert min(tilts) == pytest.approx(-30) and max(tilts) == pytest.approx(30)
    assert all(math.hypot(*each.scene.gravity) == pytest.approx(9.81) for each in by_axis["tilt"])
    angles = [each.scene.materials["sand"].friction_angle_deg for each in by_axis["friction"]]
    assert min(angles) == 15 and max(angles) == 45
    assert all(len(each.scene.bodies) == 2 for each in by_axis["collision"])
    assert {(each.jitter, each.shake, each.displaced) for each in by_axis["start"]} >= {(0.0, 0.0, 0.0)}


def test_data_that_do_not_say_what_they_are_of_are_refused() -> None:
    with pytest.raises(InputError, match="gravity, material and walls"):
        Sand.of({"gravity": 9.81}, 2, 0.02)
