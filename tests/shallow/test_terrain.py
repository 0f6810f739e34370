"""Layers on a terrain against planes, Newton's law on curved ground, lakes, and the run of the same ground turned."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.metrics.rasters import compute_maps
from gns_pl.scene import Body, Box, Plane, Raster, Scene, Terrain, Wall, make_release
from gns_pl.shallow import ShallowConfig, simulate, unsupported_reason
from gns_pl.shallow.solver import Layer, make_start
from tests.shallow.conftest import GRAVITY, Floats, make_scene, volume

FRICTION = Wall("friction", 0.3)
ANGLE = math.radians(25)


def make_terrain(height: Any, domain: tuple[float, ...], cell: float, wall: Wall = FRICTION) -> Terrain:
    lines = [np.arange(-0.5, edge / cell + 1) * cell for edge in domain[:-1]]
    return Terrain(height(*np.meshgrid(*lines, indexing="ij")), (-0.5 * cell,) * len(lines), cell, wall)


def slope_scene(**changes: Any) -> Scene:
    body = Body((0.2, 0.5), (0.5, 0.9), (0.0, 0.0))
    return make_scene((2.5, 1.6), body, **changes)


def on_slope(x: Floats) -> Floats:
    return 1.3 - math.tan(ANGLE) * x


def test_a_plane_as_a_raster_is_the_plane() -> None:
    """To 1e-7 m: the rounding of heights, which the edge of the layer makes grow."""
    plane = Plane((0.0, 1.3), (math.sin(ANGLE), math.cos(ANGLE)), FRICTION)
    scenes = slope_scene(obstacles=(plane,)), slope_scene(terrain=make_terrain(on_slope, (2.5, 1.6), 0.1))
    first, second = (make_start(scene, ShallowConfig(cell_size=2.5 / 200)) for scene in scenes)
    for layer in (first, second):
        layer.advance(0.5)
    assert np.abs(first.thickness - second.thickness).max() < 1e-7
    assert np.abs(first.momentum - second.momentum).max() < 1e-7
    assert np.abs(first.momentum).max() > 0.1


def curved_scene() -> tuple[Scene, Floats, Floats]:
    """A slope of 25°, an arc of 40 m radius and a level floor; places and heights 1 m apart."""
    x = np.arange(-0.5, 205.0)
    start, radius = 60.0, 40.0
    end, low = start + radius * math.sin(ANGLE), radius * (1 - math.cos(ANGLE))
    arc = radius - np.sqrt(radius**2 - np.clip(end - x, 0, radius / 2) ** 2)
    z = 1 + np.where(x < start, low + math.tan(ANGLE) * (start - x), arc)
    body = Body((5.0, float(z[15])), (10.0, 5.0), (0.0, 0.0))
    terrain = Terrain(z, (-0.5,), 1.0, FRICTION)
    return make_scene((200.0, 120.0), body, terrain=terrain), x, z


def test_a_thin_layer_runs_out_on_curved_ground_as_newton_says() -> None:
    """Thinner than the drop of its bed over one cell. x'' = −cos²θ (g + b'' x'²) (b' + μ); and the energy line."""
    from scipy.integrate import solve_ivp

    scene, x, z = curved_scene()
    layer = make_start(scene, ShallowConfig(cell_size=1.0))
    place, _ = layer.grid.centres
    layer.thickness[:] = 0.3 * np.clip(1 - ((place - 12) / 6) ** 2, 0, None)

    def newton(_: float, state: Any) -> list[float]:
        at, speed = state
        low, here, high = np.interp([at - 1, at, at + 1], x, z)
        slope, bend = (high - low) / 2, high - 2 * here + low
        return [speed, -(GRAVITY + bend * speed**2) * (slope + 0.3) / (1 + slope**2)]

    def stops(_: float, state: Any) -> float:
        return float(state[1])

    stops.terminal, stops.direction = True, -1  # type: ignore[attr-defined]
    exact = solve_ivp(newton, (0, 20), [12.0, 1e-6], max_step=0.05, events=stops)
    bed = layer.ground.height
    before = (bed * layer.thickness).sum() / layer.thickness.sum()
    layer.advance(20.0)
    centre, after = ((each * layer.thickness).sum() / layer.thickness.sum() for each in (place, bed))
    assert centre - 12 == pytest.approx(exact.y[0, -1] - 12, rel=0.01)
    drop = (before - after) / (centre - 12)
    assert 0.3 < drop < 0.3 * 1.15  # the energy line, but for the friction that the curve adds


@pytest.mark.parametrize("earth_pressure", [1.0, 0.5])
@pytest.mark.parametrize("share", [0.5, 0.1])
def test_a_film_on_a_rough_slope_leaves_nothing_behind(share: float, earth_pressure: float) -> None:
    """A mean slope of 30°, places between 17° and 40°, all steeper than friction holds: Newton's law, and the energy.

    The film is thinner than the drop of the bed over a cell, and than the differences of these drops.
    """
    rng = np.random.default_rng(0)
    slope = math.tan(math.radians(30))
    z = -np.cumsum(np.append(0, slope + rng.uniform(-0.27, 0.27, 201)))
    z -= z.min() - 1
    body = Body((5.0, float(z[5] + z[6]) / 2), (10.0, 2.0), (0.0, 0.0))
    scene = make_scene((200.0, float(z[0]) + 5), body, terrain=Terrain(z, (-0.5,), 1.0, FRICTION))
    layer = make_start(scene, ShallowConfig(cell_size=1.0, earth_pressure=earth_pressure))
    place, _ = layer.grid.centres
    layer.thickness[:] = np.where((place > 5) & (place < 25), share * slope, 0.0)
    before = volume(layer)
    layer.advance(9.0)
    centre = float((place * layer.thickness).sum() / layer.thickness.sum())
    travelled = GRAVITY * (slope - 0.3) / (1 + slope**2) * 9.0**2 / 2
    assert centre - 15 == pytest.approx(travelled, rel=0.05)
    assert layer.thickness[place < 60].sum() < 1e-3 * layer.thickness.sum()
    assert volume(layer) == pytest.approx(before, rel=1e-12)
    fall = float(z[5] - layer.ground.height.min()) + 2
    assert layer.speed(1e-9).max() < math.sqrt(2 * GRAVITY * fall) and layer.num_steps < 500


@pytest.mark.parametrize("friction", [Wall("slip"), Wall("friction", 0.4)])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("earth_pressure", [1.0, 0.5])
def test_a_lake_over_a_rough_terrain_stays_at_rest(dim: int, friction: Wall, earth_pressure: float) -> None:
    rng = np.random.default_rng(0)
    domain = (2.0, 1.0, 1.0)[-dim:] if dim == 3 else (2.0, 1.0)
    terrain = make_terrain(lambda x, *_: 0.3 + rng.uniform(-0.1, 0.1, x.shape), domain, 0.125, friction)
    body = Body((0.1,) * (dim - 1) + (0.2,), (0.5,) * dim, (0.0,) * dim)
    scene = make_scene(domain, body, terrain=terrain)
    layer = make_start(scene, ShallowConfig(cell_size=0.05, earth_pressure=earth_pressure))
    level = float(np.quantile(layer.ground.bed, 0.8))
    layer.thickness[:] = np.clip(level - layer.ground.bed, 0, None)
    thickness, before = layer.thickness.copy(), volume(layer)
    assert (thickness == 0).any()
    layer.advance(1.0)
    assert np.abs(layer.thickness - thickness).max() < 1e-13
    assert np.abs(layer.momentum).max() < 1e-13
    assert volume(layer) == pytest.approx(before, rel=1e-13)


def bumpy(x: Floats, y: Floats) -> Floats:
    return np.asarray(40 - 0.5 * x + 4 * np.sin(0.1 * x + 0.5) * np.cos(0.13 * y) + 0.005 * (y - 20) ** 2)


def test_a_turned_terrain_gives_the_turned_run() -> None:
    domain = (60.0, 60.0, 80.0)
    lines = np.meshgrid(np.arange(-0.5, 61), np.arange(-0.5, 61), indexing="ij")
    ground = Terrain(bumpy(*lines), (-0.5, -0.5), 1.0, FRICTION)
    square = [(5.0, 12.0), (17.0, 12.0), (17.0, 26.0), (5.0, 26.0)]
    turned = ground.replace(heights=np.rot90(ground.heights))  # (x, y) → (60 − y, x)
    config = ShallowConfig(cell_size=1.5, earth_pressure=0.7)
    layers = []
    for terrain, corners in ((ground, square), (turned, [(60 - y, x) for x, y in square])):
        release = make_release(terrain, outline=[corners], thickness=2.0)
        scene = make_scene(domain, Body((1.0,) * 3, (1.0,) * 3, (0.0,) * 3)).replace(terrain=terrain, bodies=(release,))
        layer = make_start(scene, config)
        layer.advance(4.0)
        layers.append(layer.thickness.reshape(40, 40))
    assert np.abs(np.rot90(layers[0]) - layers[1]).max() < 1e-9
    assert layers[0].sum() * 1.5**2 == pytest.approx(12 * 14 * 2.0, rel=1e-9)


def uniform_speed(turbulence: float | None, time: float) -> float:
    """Speed in the middle of a layer of 0.5 m that fills a long slope of 25°."""
    terrain = make_terrain(lambda x: 200 - math.tan(ANGLE) * x, (400.0, 210.0), 2.0)
    scene = make_scene((400.0, 210.0), Body((0.0, 0.0), (400.0, 209.0), (0.0, 0.0)), terrain=terrain)
    layer = make_start(scene, ShallowConfig(cell_size=2.0, turbulence=turbulence))
    layer.thickness[:] = 0.5
    layer.advance(time)
    return float(layer.momentum[0, 100] / layer.thickness[100])


def test_voellmys_drag_lets_a_layer_reach_its_terminal_speed() -> None:
    """v² = ξ H (sin θ − μ cos θ) along the slope, with H = h cos θ across it; without drag it is Newton's law."""
    push = math.sin(ANGLE) - 0.3 * math.cos(ANGLE)
    along = math.sqrt(200.0 * 0.5 * math.cos(ANGLE) * push)
    assert uniform_speed(200.0, 12.0) == pytest.approx(along * math.cos(ANGLE), rel=1e-3)
    assert uniform_speed(None, 4.0) == pytest.approx(4 * GRAVITY * push * math.cos(ANGLE), rel=1e-6)
    with pytest.raises(InputError, match="turbulence must be a finite number above 0"):
        ShallowConfig(cell_size=1.0, turbulence=0.0)


def test_friction_across_the_fall_line_is_that_of_the_shorter_path() -> None:
    """A layer that moves along a contour loses μ g cos θ of its speed, as long as it has not turned downhill."""
    tilted = make_terrain(lambda x, y: 3 - 0.5 * x, (2.0, 2.0, 5.0), 0.5)
    scene = make_scene((2.0, 2.0, 5.0), Body((0.0,) * 3, (2.0, 2.0, 4.0), (0.0,) * 3), terrain=tilted)
    layer = make_start(scene, ShallowConfig(cell_size=0.125))
    layer.thickness[:] = 0.5
    layer.momentum[1] = 0.5 * 2.0
    layer.advance(0.02)
    middle = 8 * 16 + 8
    lost = 2.0 - layer.momentum[1, middle] / layer.thickness[middle]
    assert lost == pytest.approx(0.3 * GRAVITY * 0.02 / math.sqrt(1.25), rel=0.01)


def test_particles_of_a_release_lie_on_the_terrain_and_boxes_stand_on_it() -> None:
    domain = (60.0, 60.0, 80.0)
    terrain = make_terrain(bumpy, domain, 1.0)
    depth = Raster(np.full((8, 6), 1.5), (10.5, 15.5), 1.0)
    release = make_release(terrain, thickness=depth)
    box = Box((30.0, 0.0, 0.0), (4.0, 60.0, 60.0), FRICTION)
    scene = make_scene(domain, Body((1.0,) * 3, (1.0,) * 3, (0.0,) * 3)).replace(terrain=terrain, bodies=(release,))
    config = ShallowConfig(cell_size=1.0, num_particles=2000)
    run = simulate(scene.replace(obstacles=(box,)), config, frame_interval=1.0)
    above = run.position[0][:, 2] - terrain.height(run.position[0])
    assert above.min() > -1e-4 and above.max() < 1.5 + 1e-4
    assert above.mean() == pytest.approx(0.75, rel=0.02)
    assert run.volume().sum() == pytest.approx(8 * 6 * 1.5, rel=1e-4)
    assert run.position[..., 0].max() < 30.1
    assert simulate(scene, config, frame_interval=1.0).position[..., 0].max() > 5


def test_what_a_layer_on_a_terrain_cannot_be_is_told() -> None:
    scene = slope_scene(terrain=make_terrain(on_slope, (2.5, 1.6), 0.1))
    air = scene.replace(bodies=(Body((0.2, 1.4), (0.1, 0.1), (0.0, 0.0)),))
    assert "starts 0.193 m above" in str(unsupported_reason(air))
    steep = scene.replace(terrain=make_terrain(lambda x: 1.5 - 2 * np.abs(x - 2), (2.5, 1.6), 0.1), bodies=air.bodies)
    body = Body((0.2, -1.0 + 1.0), (0.3, 1.0), (0.0, 0.0))
    with pytest.raises(InputError, match=r"shallow: scene 'box': .* as steep as 63°, and 60° .* larger cells"):
        make_start(steep.replace(bodies=(body,)), ShallowConfig(cell_size=0.1))


def test_a_layer_without_a_terrain_knows_no_curve() -> None:
    scene = make_scene((2.5, 1.6), Body((0.2, 0.0), (0.5, 0.9), (0.0, 0.0)))
    layer: Layer = make_start(scene, ShallowConfig(cell_size=0.1))
    assert len(layer.ground.curve) == 0 and len(layer.ground.drag) == 0


def test_the_map_of_largest_velocity_is_that_of_the_layer() -> None:
    """Amid a wide layer nothing but slope and friction acts: v = g (sin θ − μ cos θ) t, along the ground."""
    terrain = make_terrain(lambda x, y: 2.2 - math.tan(ANGLE) * x + 0.0 * y, (4.0, 2.0, 3.0), 0.05)
    release = make_release(terrain, outline=[[(0.5, 0.5), (2.5, 0.5), (2.5, 1.5), (0.5, 1.5)]], thickness=0.04)
    scene = make_scene((4.0, 2.0, 3.0), release, terrain=terrain, duration=0.5)
    run = simulate(scene, ShallowConfig(cell_size=0.05), frame_interval=0.1)
    maps = compute_maps(run, reached=0.01)
    assert maps.max_velocity is not None
    speed = GRAVITY * (math.sin(ANGLE) - 0.3 * math.cos(ANGLE)) * 0.5
    x, y = maps.grid.centres
    inside = maps.max_velocity[np.ix_((x > 1.2) & (x < 2.2), (y > 0.8) & (y < 1.2))]
    assert inside == pytest.approx(speed, rel=0.01)
    assert not maps.max_velocity[maps.max_thickness < 0.01].any()
    assert maps.max_velocity[x > 3.5].max() == 0.0 < maps.max_velocity[(x > 0.55) & (x < 0.8)].max()
    del run.provenance["largest_velocity"]
    assert compute_maps(run, reached=0.01).max_velocity is None
