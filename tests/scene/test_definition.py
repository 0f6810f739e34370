"""A scene says in one sentence what is wrong with it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from gns_pl.errors import InputError
from gns_pl.scene import FACES, Body, Box, Material, Plane, Scene, Wall

SAND: dict[str, Any] = {
    "density": 1800,
    "youngs_modulus": 2e6,
    "poisson_ratio": 0.3,
    "friction_angle_deg": 30,
}


SLIP = Wall("slip")


def make(**changes: Any) -> Scene:
    values: dict[str, Any] = {
        "name": "two blocks",
        "lower": (0, 0, 0),
        "upper": (1, 1, 1),
        "gravity": (0, 0, -9.81),
        "duration": 1,
        "materials": {"sand": Material(**SAND)},
        "bodies": (Body((0, 0, 0), (0.2, 0.2, 0.2), (0, 0, 0)), Body((0.2, 0, 0), (0.2, 0.2, 0.2), (1, 0, 0))),
        "walls": {face: Wall("slip") for face in FACES[3]},
    }
    return Scene(**(values | changes))


def test_touching_bodies_and_bodies_that_fill_the_box_are_fine() -> None:
    assert make().dim == 3
    assert make(bodies=(Body((0, 0, 0), (1, 1, 1), (0, 0, 0)),)).bodies[0].upper == (1, 1, 1)
    third = 1 / 3
    row = tuple(Body((k * third, 0, 0), (third, 1, 1), (0, 0, 0)) for k in range(3))
    assert len(make(bodies=row).bodies) == 3


def test_bodies_may_touch_obstacles_and_reach_into_them() -> None:
    slope, step = Plane((0, 0, 0.1), (-1, 0, 2), SLIP), Box((0.1, -1, 0.1), (0.2, 2, 0.5), SLIP)
    assert make(obstacles=[slope, step]).obstacles == (slope, step)
    assert make(obstacles=(Plane((0, 0, 0), (0, 0, 1), SLIP),))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"name": ""}, "name must be a word"),
        ({"name": "../evil"}, "name must be a word"),
        ({"name": 3}, "name must be a word"),
        ({"lower": (0,)}, "2 or 3 dimensions, not 1"),
        ({"lower": (0, 0, 0, 0)}, "2 or 3 dimensions, not 4"),
        ({"lower": "000"}, "lower must be a list of numbers"),
        ({"lower": 0}, "lower must be a list of numbers"),
        ({"upper": (1, 1)}, "upper must have 3 entries"),
        ({"upper": (1, 1, math.inf)}, "upper must hold finite numbers"),
        ({"upper": (1, 1, True)}, "upper must be a list of numbers"),
        ({"upper": (1, 0, 1)}, "must lie above lower"),
        ({"gravity": (0, -9.81)}, "gravity must have 3 entries"),
        ({"gravity": (0, 0, "down")}, "gravity must be a list of numbers"),
        ({"duration": 0}, "duration must be a finite number above 0"),
        ({"duration": math.nan}, "duration must be a finite number"),
        ({"duration": True}, "duration must be a number"),
        ({"bodies": ()}, "needs at least one body"),
        ({"walls": {face: Wall("slip") for face in FACES[2]}}, "walls must name the faces x-, x.,"),
        ({"bodies": (Body((0.9, 0, 0), (0.2, 0.2, 0.2), (0, 0, 0)),)}, "outside the domain"),
        ({"bodies": (Body((0, 0, -0.01), (0.2, 0.2, 0.2), (0, 0, 0)),)}, "outside the domain"),
        ({"bodies": (Body((0, 0), (0.2, 0.2), (0, 0)),)}, "body 0: position must have 3 entries"),
        ({"bodies": (Body((0, 0, 0), (0.2, 0.2, 0.2), (0, 0)),)}, "body 0: velocity must have 3 entries"),
        ({"bodies": (Body((0, 0, 0), (0.2, 0.2, 0.2), (0, 0, 0), "clay"),)}, "material 'clay' is not among sand"),
        ({"bodies": (Body((0, 0, 0), (0.3,) * 3, (0, 0, 0)), Body((0.2,) * 3, (0.3,) * 3, (0, 0, 0)))}, "0 and 1 over"),
        ({"obstacles": (Plane((0, 0), (0, 1), SLIP),)}, "obstacle 0: point must have 3 entries"),
        ({"obstacles": (Plane((0, 0, 0), (0, 1), SLIP),)}, "obstacle 0: normal must have 3 entries"),
        ({"obstacles": (Box((0, 0, 0), (0.1, 0.1), SLIP),)}, "obstacle 0: size must have 3 entries"),
        ({"obstacles": (Box((1, 0, 0), (0.1, 0.1, 0.1), SLIP),)}, "obstacle 0: .* nowhere in the domain"),
        ({"obstacles": (Plane((0, 0, 0.2), (0, 0, 1), SLIP),)}, "body 0: it lies entirely inside obstacle 0"),
        ({"obstacles": (Box((0.2, 0, 0), (0.2, 0.2, 0.2), SLIP),)}, "body 1: it lies entirely inside obstacle 0"),
    ],
)
def test_scene_refuses(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        make(**changes)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"density": 0}, "density must be a finite number above 0"),
        ({"density": "heavy"}, "density must be a number"),
        ({"youngs_modulus": -1}, "youngs_modulus must be"),
        ({"poisson_ratio": 0.5}, "poisson_ratio must be below 0.5"),
        ({"poisson_ratio": -1}, "poisson_ratio must be a finite number above -1"),
        ({"friction_angle_deg": 90}, "friction_angle_deg must be below 90"),
        ({"friction_angle_deg": -5}, "friction_angle_deg must be"),
        ({"dilation_angle_deg": 31}, "must not exceed friction_angle_deg"),
        ({"cohesion": -1}, "cohesion must be"),
        ({"tension_cutoff": math.nan}, "tension_cutoff must be"),
    ],
)
def test_material_refuses(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Material(**(SAND | changes))


def test_material_derives_its_numbers() -> None:
    sand = Material(**SAND)
    assert sand.tan_friction_angle == pytest.approx(0.57735, abs=1e-5)
    assert sand.p_wave_speed == pytest.approx(38.7, abs=0.05)  # physics.md


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("sticky",), "condition must be one of stick, slip, friction"),
        (("friction", -0.1), "friction must be a finite number of at least 0"),
        (("slip", 0.3), 'needs condition "friction"'),
    ],
)
def test_wall_refuses(arguments: tuple[Any, ...], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Wall(*arguments)


@pytest.mark.parametrize("size", [(0.1, 0.1, 0), (0.1, -0.1, 0.1), ()])
def test_body_refuses_what_has_no_volume(size: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="size must be positive"):
        Body((0, 0, 0), size, (0, 0, 0))


def test_replace_checks_again() -> None:
    assert make().replace(duration=2).duration == 2
    with pytest.raises(InputError, match="duration"):
        make().replace(duration=-2)
