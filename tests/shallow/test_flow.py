"""What a layer must do as a whole: keep its volume, rest, stop, turn with its scene."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gns_pl.scene import Body, Box, Plane, Scene, Wall
from gns_pl.shallow import ShallowConfig
from gns_pl.shallow.solver import Layer, make_start
from tests.shallow.conftest import GRAVITY, Floats, make_column, make_layer, make_scene, volume

COARSE = ShallowConfig(cell_size=1 / 24)


def run(scene: Scene, config: ShallowConfig = COARSE, end: float | None = None) -> Layer:
    layer = make_start(scene, config)
    layer.advance(scene.duration if end is None else end)
    return layer


def field(layer: Layer) -> Floats:
    return layer.thickness.reshape(layer.grid.shape)


def two_bodies(**changes: object) -> Scene:
    """Two unlike bodies that run into each other, a box and the walls."""
    bodies = (
        Body((0.0, 0.0, 0.0), (0.3, 0.25, 0.4), (0.0, 0.0, 0.0)),
        Body((0.7, 0.4, 0.0), (0.25, 0.3, 0.2), (-1.0, 0.5, 0.0)),
    )
    box = Box((0.45, 0.1, 0.0), (0.1, 0.2, 0.3), Wall("friction", 0.385))
    return make_scene((1.0, 0.75, 0.6), *bodies, obstacles=(box,), **changes)


@pytest.mark.parametrize("rain", [None, 0.5, 0.0])
def test_volume_is_kept_and_thickness_never_negative(rain: float | None) -> None:
    layer = make_start(two_bodies(), replace(COARSE, rain=rain))
    start = volume(layer)
    assert start == pytest.approx(0.3 * 0.25 * 0.4 + 0.25 * 0.3 * 0.2, rel=1e-12)
    for time in np.linspace(0.1, 1.5, 15):
        layer.advance(time)
        assert volume(layer) == pytest.approx(start, rel=1e-12)
        assert layer.thickness.min() >= 0
    assert layer.at_rest


def test_a_flow_stops_by_itself_and_then_nothing_changes() -> None:
    layer = run(make_column(3))
    assert layer.at_rest
    assert not layer.momentum.any()
    thickness, steps = layer.thickness.copy(), layer.num_steps
    layer.at_rest = False  # look again, whether it really has
    layer.advance(layer.time + 1.0)
    assert np.array_equal(layer.thickness, thickness)
    assert layer.num_steps == steps


@pytest.mark.parametrize(("slope", "moves"), [(0.9, False), (1.2, True)])
@pytest.mark.parametrize("counts", [(60, 1), (40, 40)])
def test_a_heap_rests_below_the_angle_of_friction_alone(counts: tuple[int, int], slope: float, moves: bool) -> None:
    """A cone (a wedge in one dimension) whose sides rise by `slope` times the friction."""
    friction = 0.4

    def heap(x: Floats, y: Floats) -> Floats:
        distance = np.hypot(x - 0.5, y - 0.5) if counts[1] > 1 else np.abs(x - 0.5)
        return np.clip(slope * friction * (0.35 - distance), 0, None)

    layer = make_layer(counts, (1.0, 1.0), heap, friction=friction)
    thickness = layer.thickness.copy()
    layer.advance(2.0)
    assert layer.at_rest
    assert not layer.momentum.any()
    change = np.abs(layer.thickness - thickness).sum() / thickness.sum()
    assert change > 0.02 if moves else change == 0


@pytest.mark.parametrize("above", [-1.0, 3.0])
@pytest.mark.parametrize("tilted", [True, False])
def test_a_layer_on_a_slope_slides_from_the_angle_of_friction_on(above: float, tilted: bool) -> None:
    friction = 0.3
    angle = math.atan(friction) + math.radians(above)
    if tilted:
        gravity = (GRAVITY * math.sin(angle), -GRAVITY * math.cos(angle))
        body = Body((0.0, 0.0), (4.0, 0.02), (0.0, 0.0))
        scene = make_scene((4.0, 2.5), body, gravity=gravity, floor=Wall("friction", friction))
    else:
        plane = Plane((0.0, 2.0), (math.sin(angle), math.cos(angle)), Wall("friction", friction))
        scene = make_scene((4.0, 2.5), Body((0.0, 0.0), (4.0, 2.5), (0.0, 0.0)), obstacles=(plane,))
    layer = make_start(scene, ShallowConfig(cell_size=0.02))
    x, _ = layer.grid.centres
    layer.thickness[:] = np.where(np.abs(x - 1.5) < 1, 0.02, 0)
    layer.advance(0.6)
    middle = np.abs(x - 1.5) < (0.6 if above < 0 else 0.3)  # the ends are steps; their waves have not come so far
    velocity = layer.momentum[0][middle] / layer.thickness[middle]
    if above < 0:
        assert not velocity.any()
    else:
        push = GRAVITY * (math.sin(angle) - friction * math.cos(angle)) * (1.0 if tilted else math.cos(angle))
        assert velocity == pytest.approx(0.6 * push, rel=1e-5)


def test_plane_strain_in_a_channel_is_the_same_in_one_and_two_dimensions() -> None:
    flat, channel = run(make_column(2), end=0.4), run(make_column(3), end=0.4)
    assert flat.num_steps == channel.num_steps
    assert np.abs(field(channel) - field(flat)).max() < 1e-14
    assert np.abs(channel.momentum[1]).max() < 1e-14


def test_a_scene_turned_by_a_right_angle_flows_turned() -> None:
    scene = two_bodies()

    def turned(values: tuple[float, ...]) -> tuple[float, ...]:
        return (values[1], values[0], values[2])

    other = scene.replace(
        upper=turned(scene.upper),
        bodies=tuple(
            replace(body, position=turned(body.position), size=turned(body.size), velocity=turned(body.velocity))
            for body in scene.bodies
        ),
        obstacles=tuple(replace(box, position=turned(box.position), size=turned(box.size)) for box in scene.obstacles),
    )
    first, second = run(scene, end=0.4), run(other, end=0.4)
    assert np.abs(field(first) - field(second).T).max() < 1e-12
    assert (
        np.abs(first.momentum[0].reshape(first.grid.shape) - second.momentum[1].reshape(second.grid.shape).T).max()
        < 1e-12
    )


def test_a_block_turned_by_45_degrees_leaves_the_same_deposit() -> None:
    from scipy.ndimage import rotate

    def square(x: Floats, y: Floats) -> Floats:
        return 0.2 * ((np.abs(x - 1) < 0.25) & (np.abs(y - 1) < 0.25))

    def diamond(x: Floats, y: Floats) -> Floats:
        return square(1 + (x - y) / math.sqrt(2), 1 + (x + y - 2) / math.sqrt(2))

    layers = [make_layer((80, 80), (2.0, 2.0), shape, friction=0.4, samples=5) for shape in (square, diamond)]
    for layer in layers:
        layer.advance(1.0)
        assert layer.at_rest
    straight, turned = (field(layer) for layer in layers)
    back = rotate(turned, 45, reshape=False, order=1)
    assert np.abs(back - straight).sum() / straight.sum() < 0.04


def test_a_tall_box_stops_a_flow_and_a_low_one_does_not() -> None:
    behind = []
    for height in (0.02, 0.5):
        box = Box((0.7, 0.0), (0.1, height), Wall("friction", 0.385))
        layer = run(make_column(2, obstacles=(box,)), ShallowConfig(cell_size=1 / 50))
        x, _ = layer.grid.centres
        behind.append(layer.thickness[x > 0.8].sum() / layer.thickness.sum())
        assert layer.at_rest
    assert behind[0] > 0.1
    assert behind[1] == 0


def test_a_cliff_pushes_like_a_wall() -> None:
    """A flow against a tall box goes on as against the wall of a shorter box."""
    config = ShallowConfig(cell_size=0.05)
    box = Box((0.9, 0.0), (0.6, 0.69), Wall("friction", 0.385))
    against_box = run(make_column(2, obstacles=(box,)), config, end=0.5)
    against_wall = run(make_column(2).replace(upper=(0.9, 0.7)), config, end=0.5)
    assert against_wall.thickness[-1] > 0.02
    assert np.abs(against_box.thickness[:18] - against_wall.thickness).max() < 1e-14
    assert not against_box.thickness[18:].any()


def test_floors_and_settings_decide_how_far_it_goes() -> None:
    def front(scene: Scene, **changes: object) -> float:
        layer = run(scene, replace(COARSE, **changes))  # type: ignore[arg-type]
        x, _ = layer.grid.centres
        return float(x[layer.thickness > 1e-3].max())

    plain = front(make_column(2))
    assert front(make_column(2), friction=0.385) == plain
    assert front(make_column(2), friction=0.6) < plain
    assert front(make_column(2), earth_pressure=0.6) < plain
    assert front(make_column(2, floor=Wall("stick"))) == front(make_column(2), friction=math.tan(math.radians(30)))
    tall = make_column(2, length=0.1, height=0.4)
    assert front(tall, rain=1.0) < front(tall)


def test_rain_onto_a_dry_floor_goes_about_as_far_as_onto_a_layer() -> None:
    fronts = []
    for rain in (0.0, 1.0):
        layer = run(make_column(2, length=0.1, height=0.4), ShallowConfig(cell_size=1 / 100, friction=0.5, rain=rain))
        x, _ = layer.grid.centres
        fronts.append(x[layer.thickness > 1e-4].max())
    assert fronts[0] == pytest.approx(fronts[1], rel=0.2)


def test_rain_comes_down_in_the_time_of_free_fall() -> None:
    layer = make_start(make_column(2, length=0.2, height=0.6), ShallowConfig(cell_size=1 / 50, rain=1.0))
    assert layer.falling.max() == pytest.approx(0.4)
    layer.advance(0.1)
    assert layer.falling.max() == pytest.approx(0.4 - 0.5 * GRAVITY * 0.1**2)
    layer.advance(math.sqrt(2 * 0.4 / GRAVITY))
    assert layer.falling.max() == pytest.approx(0, abs=1e-15)
    assert volume(layer) == pytest.approx(0.12)


@pytest.mark.parametrize("cells", [24, 96])
def test_a_tip_is_no_faster_than_a_dam_break_allows(cells: int) -> None:
    """Ritter's tip runs with 2 √(g H); friction can only slow it, however thin the tip is."""
    layer = make_start(make_column(2).replace(upper=(6.0, 0.7)), ShallowConfig(cell_size=1 / cells))
    for time in (0.05, 0.1, 0.2, 0.3):
        layer.advance(time)
        wet = layer.thickness > 1e-9
        assert (layer.momentum[0][wet] / layer.thickness[wet]).max() < 2 * math.sqrt(GRAVITY * 0.38)
