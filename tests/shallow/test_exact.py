"""Against exact solutions of the equations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gns_pl.scene import Body, Plane, Wall
from gns_pl.shallow import ShallowConfig
from gns_pl.shallow.solver import Layer, make_start
from tests.shallow.conftest import GRAVITY, Floats, make_layer, make_scene, volume

SLOPE, FRICTION = math.radians(25), 0.3


def dam_break(x: Floats, time: float, thickness: float, gravity: float, push: float) -> tuple[Floats, Floats]:
    """Thickness and velocity behind a dam at x = 0 that is taken away on a slope steeper than the friction.

    Mangeney, Heinrich and Roche (2000), eqs 24 and 25: Ritter's parabola in the frame that slides down with the
    acceleration m.

    Args:
        x: places down the slope [N] [m].
        time: since the dam is gone [s].
        thickness: of the reservoir [m].
        gravity: that presses the layer on the bed [m/s²].
        push: m, gravity along the bed less friction [m/s²].
    """
    wave = math.sqrt(gravity * thickness)
    own = (x - 0.5 * push * time**2) / time
    h = np.where(own < -wave, thickness, np.clip(2 * wave - own, 0, None) ** 2 / (9 * gravity))
    u = push * time + np.where(own < -wave, 0.0, 2 / 3 * (own + wave))
    return h, np.where(own < 2 * wave, u, 0.0)


def dam_error(layer: Layer, dam: float, time: float, thickness: float, gravity: float, push: float) -> float:
    """Relative L1 error of thickness and momentum where the far end of the reservoir is not felt yet."""
    layer.advance(time)
    x, _ = layer.grid.centres
    h, u = dam_break(x - dam, time, thickness, gravity, push)
    felt = x > 0.5 * dam
    errors = [
        np.abs(found - exact)[felt].sum() / np.abs(exact)[felt].sum()
        for found, exact in ((layer.thickness, h), (layer.momentum[0], h * u))
    ]
    return max(errors)


def test_dam_break_with_friction_on_a_slope() -> None:
    gravity, push = GRAVITY * math.cos(SLOPE), GRAVITY * (math.sin(SLOPE) - FRICTION * math.cos(SLOPE))
    errors = []
    for number in (200, 400, 800):
        tilted = (GRAVITY * math.sin(SLOPE), -gravity)
        scene = make_scene((2.5, 0.3), Body((0.0, 0.0), (1.0, 0.1), (0.0, 0.0)), gravity=tilted)
        layer = make_start(scene, ShallowConfig(cell_size=2.5 / number, friction=FRICTION))
        errors.append(dam_error(layer, 1.0, 0.3, 0.1, gravity, push))
    assert errors[-1] < 0.004
    assert math.log2(errors[0] / errors[2]) / 2 > 0.8  # the solution has corners, so first order at most


def test_dam_break_on_a_slope_that_is_an_obstacle() -> None:
    """The same slope in a level box: thickness and places are now vertical and horizontal."""
    cosine = math.cos(SLOPE)
    gravity, push = GRAVITY * cosine**2, GRAVITY * cosine**2 * (math.tan(SLOPE) - FRICTION)
    plane = Plane((0.0, 1.3), (math.sin(SLOPE), cosine), Wall("friction", FRICTION))
    scene = make_scene((2.5, 1.6), Body((0.0, 0.0), (2.5, 1.6), (0.0, 0.0)), obstacles=(plane,))
    layer = make_start(scene, ShallowConfig(cell_size=2.5 / 400))
    x, _ = layer.grid.centres
    assert layer.ground.height == pytest.approx(1.3 - math.tan(SLOPE) * x)
    layer.thickness[:] = np.where(x < 1.0, 0.1, 0.0)
    assert dam_error(layer, 1.0, 0.3, 0.1, gravity, push) < 0.01


def cap_length(start: float, crest: float, time: float, dim: int) -> float:
    """Half length (radius) of a parabolic cap that spreads without friction: L'' = 2 g h0 L0^d / L^(d+1) from rest."""
    from scipy.integrate import solve_ivp

    strength = 2 * GRAVITY * crest * start**dim
    found = solve_ivp(lambda _, y: [y[1], strength / y[0] ** (dim + 1)], (0, time), [start, 0.0], rtol=1e-10)
    return float(found.y[0, -1])


def test_a_parabolic_cap_stays_one_while_it_spreads() -> None:
    """Savage and Hutter (1989): similar at all times; second order but for the two corners at its ends."""
    start, crest, time = 0.5, 0.1, 0.4
    length = cap_length(start, crest, time, 1)
    errors = []
    for number in (100, 200, 400):
        layer = make_layer(
            (number, 1), (3.0, 1.0), lambda x, _: np.clip(crest * (1 - ((x - 1.5) / start) ** 2), 0, None), samples=9
        )
        layer.advance(time)
        x, _ = layer.grid.centres
        exact = np.clip(crest * start / length * (1 - ((x - 1.5) / length) ** 2), 0, None)
        errors.append(np.abs(layer.thickness - exact).sum() / exact.sum())
    assert length > 1.5 * start
    assert errors[-1] < 0.001
    assert math.log2(errors[0] / errors[2]) / 2 > 1.4


def test_a_parabolic_cap_slides_down_with_friction_as_it_spreads() -> None:
    """As long as all of it goes downhill, friction is one force for all, and the cap spreads as without it."""
    start, crest, time = 0.5, 0.04, 0.5
    gravity = GRAVITY * math.cos(SLOPE)
    push = GRAVITY * (math.sin(SLOPE) - FRICTION * math.cos(SLOPE))
    assert push > 2 * gravity * crest / start
    layer = make_layer(
        (400, 1),
        (3.0, 1.0),
        lambda x, _: np.clip(crest * (1 - ((x - 1.0) / start) ** 2), 0, None),
        bed=lambda x, _: -math.tan(SLOPE) * x,
        friction=FRICTION,
        gravity=gravity,
        samples=9,
    )
    layer.advance(time)
    x, _ = layer.grid.centres
    length = cap_length(start, crest * gravity / GRAVITY, time, 1)
    middle = 1.0 + 0.5 * push * time**2
    exact = np.clip(crest * start / length * (1 - ((x - middle) / length) ** 2), 0, None)
    assert np.abs(layer.thickness - exact).sum() / exact.sum() < 0.01
    centre = (x * layer.thickness).sum() / layer.thickness.sum()
    assert centre == pytest.approx(middle, abs=0.001 * (middle - 1.0))


def test_a_round_cap_stays_round_and_a_cap() -> None:
    start, crest, time = 0.5, 0.1, 0.4

    def thickness(x: Floats, y: Floats) -> Floats:
        return np.clip(crest * (1 - ((x - 1) ** 2 + (y - 1) ** 2) / start**2), 0, None)

    layer = make_layer((80, 80), (2.0, 2.0), thickness, samples=5)
    layer.advance(time)
    radius = cap_length(start, crest, time, 2)
    x, y = layer.grid.centres
    exact = np.clip(crest * (start / radius) ** 2 * (1 - ((x - 1) ** 2 + (y - 1) ** 2) / radius**2), 0, None)
    assert radius > 1.4 * start
    assert np.abs(layer.thickness - exact).sum() / exact.sum() < 0.02


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("counts", [(60, 1), (60, 40)])
def test_a_lake_stays_level_over_bumps_and_around_islands(counts: tuple[int, int], friction: float) -> None:
    def bed(x: Floats, y: Floats) -> Floats:
        return 0.3 * np.sin(5 * x) * np.cos(3 * y) + 0.5 * (np.abs(x - 0.7) < 0.08)

    layer = make_layer(counts, (2.0, 1.0), lambda x, y: np.clip(0.1 - bed(x, y), 0, None), bed=bed, friction=friction)
    thickness, before = layer.thickness.copy(), volume(layer)
    assert (thickness == 0).any()
    layer.advance(1.0)
    assert np.abs(layer.thickness - thickness).max() < 1e-14
    assert np.abs(layer.momentum).max() < 1e-14
    assert volume(layer) == pytest.approx(before, rel=1e-14)
