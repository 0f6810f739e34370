from __future__ import annotations

import math

import pytest

from gns_pl.mpm.walls import STICK, clearance, hold_at_walls, normal_velocity, slip_factor


def at_floor(
    velocity: tuple[float, float, float], friction: float, *, limit: float = 0.0
) -> tuple[float, float, float]:
    held: tuple[float, float, float] = hold_at_walls(
        *velocity, math.inf, math.inf, limit, 0.0, 0.0, -1.0, 0.0, 0.0, friction
    )
    return held


def test_slip_stops_only_the_motion_through_the_wall() -> None:
    assert at_floor((1.0, 2.0, -3.0), 0.0) == (1.0, 2.0, 0.0)


def test_material_may_leave_any_wall_but_a_sticking_one() -> None:
    assert at_floor((1.0, 2.0, 3.0), 0.5) == (1.0, 2.0, 3.0)
    assert at_floor((1.0, 2.0, 3.0), STICK) == (0.0, 0.0, 0.0)
    assert at_floor((1.0, 2.0, 3.0), STICK, limit=0.1) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("friction", [0.1, 0.5, 2.0])
def test_coulomb_takes_friction_times_the_normal_change(friction: float) -> None:
    x, y, z = at_floor((3.0, 4.0, -2.0), friction)
    assert z == 0.0
    assert math.hypot(x, y) == pytest.approx(max(5.0 - friction * 2.0, 0.0))
    assert x * 4.0 == pytest.approx(y * 3.0)  # the direction stays


def test_a_gap_lets_the_material_come_down_to_the_wall_in_one_step() -> None:
    assert normal_velocity(3.0, 1.0, 0.5) == 1.0
    assert normal_velocity(0.5, 1.0, 0.5) == 0.5
    assert at_floor((1.0, 0.0, -3.0), 0.1, limit=1.0) == pytest.approx((0.8, 0.0, -1.0))


def test_an_edge_obeys_both_of_its_walls() -> None:
    x, y, z = hold_at_walls(-1.0, 2.0, -3.0, 0.0, math.inf, 0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.2)
    assert (x, z) == (0.0, 0.0)
    assert y == pytest.approx(2.0 - 0.2 * 3.0)
    assert hold_at_walls(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0) == (0.0, 0.0, 0.0)


def test_nothing_to_slow_is_no_division_by_zero() -> None:
    assert slip_factor(1.0, 0.0, 0.5) == 0.0
    assert at_floor((0.0, 0.0, -1.0), 0.5) == (0.0, 0.0, 0.0)


def test_clearance_is_counted_from_the_surface_of_the_points() -> None:
    assert clearance(0.3, 0.125, 0.5) == pytest.approx(0.175)
    assert clearance(0.1, 0.125, 0.5) == 0.0
    assert clearance(0.13, 0.125, 0.5) > 0.0
    assert clearance(0.13, 0.125, STICK) == 0.0  # stretched a little, still held
