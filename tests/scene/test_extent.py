"""Compression by own weight: closed forms, and who is told."""

from __future__ import annotations

import pytest

from gns_pl.scene import Body, Material, Scene, Wall
from gns_pl.scene.extent import compression_notice, own_weight_strain

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
