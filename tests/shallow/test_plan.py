"""What a scene becomes on the grid, and which scenes are told to go elsewhere."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Body, Box, Plane, Scene, Wall
from gns_pl.shallow import ShallowConfig, simulate, unsupported_reason
from gns_pl.shallow.plan import make_grid, make_ground, spreading_length
from gns_pl.shallow.solver import make_start
from tests.shallow.conftest import GRAVITY, make_column, make_sand, make_scene

WALL = Wall("friction", 0.3)
STILL = (0.0, 0.0)


def test_scenes_that_can_be_run_have_no_reason() -> None:
    ramp = Plane((0.0, 0.4), (math.sin(0.4), math.cos(0.4)), WALL)
    assert unsupported_reason(make_column(2)) is None
    assert unsupported_reason(make_column(3, obstacles=(Box((0.8, 0.1, 0.0), (0.1, 0.3, 0.3), WALL),))) is None
    assert unsupported_reason(make_scene((2.0, 1.0), Body((0.0, 0.2), (0.3, 0.4), STILL), obstacles=(ramp,))) is None
    stacked = make_scene((2.0, 1.0), Body((0.0, 0.0), (0.4, 0.2), STILL), Body((0.1, 0.2), (0.2, 0.2), STILL))
    assert unsupported_reason(stacked) is None
    assert make_start(stacked, ShallowConfig(cell_size=0.1)).thickness[:5] == pytest.approx([0.2, 0.4, 0.4, 0.2, 0])


def two_sands(floor: Wall, **changes: Any) -> Scene:
    """Two columns that differ in their material."""
    bodies = (Body((0.0, 0.0), (0.3, 0.3), STILL), Body((0.5, 0.0), (0.3, 0.3), STILL, "gravel"))
    materials = {"sand": make_sand(), "gravel": make_sand(**({"friction_angle_deg": 40.0} | changes))}
    return make_scene((2.0, 1.0), *bodies, materials=materials, floor=floor)


@pytest.mark.parametrize(
    ("scene", "part"),
    [
        (make_scene((2.0, 1.0), Body((0.0, 0.1), (0.3, 0.3), STILL)), "body 0 starts 0.1 m above"),
        (make_scene((2.0, 1.0), Body((0.0, 0.0), (0.3, 0.3), (0.0, -1.0))), "no vertical velocity"),
        (make_column(2, obstacles=(Plane((1.0, 0.0), (-1.0, 0.0), WALL),)), "obstacle 0 is steeper"),
        (make_column(2, obstacles=(Box((0.8, 0.2), (0.1, 0.1), WALL),)), "obstacle 0 stands above the floor"),
        (make_column(2).replace(gravity=(9.0, -4.0)), "gravity within 60°"),
        (make_column(2).replace(gravity=(0.0, 0.0)), "gravity within 60°"),
        (two_sands(Wall("stick")), "one friction"),
        (two_sands(Wall("slip"), density=2000.0), "one density"),
    ],
)
def test_scenes_that_cannot_be_run_say_why(scene: Scene, part: str) -> None:
    reason = unsupported_reason(scene)
    assert reason is not None
    assert part in reason
    assert reason.endswith(".")
    with pytest.raises(InputError, match="scene 'box': depth-averaged flow"):
        simulate(scene, ShallowConfig(cell_size=0.1), frame_interval=0.1)


def test_two_sands_flow_together_where_the_floor_decides_and_keep_their_features() -> None:
    run = simulate(two_sands(WALL), ShallowConfig(cell_size=0.05, num_particles=64), frame_interval=0.1)
    left = run.position[0, :, 0] < 0.4
    assert left.sum() == 32
    assert run.material[left, 0] == pytest.approx(math.tan(math.radians(30)))
    assert run.material[~left, 0] == pytest.approx(math.tan(math.radians(40)))


@pytest.mark.parametrize(
    "changes",
    [{"cell_size": 0}, {"courant": 0.6}, {"friction": -1}, {"earth_pressure": 0}, {"rain": -1}, {"num_particles": 0.5}],
)
def test_settings_out_of_range_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        ShallowConfig(**({"cell_size": 0.1} | changes))


def test_a_frame_interval_must_be_positive() -> None:
    with pytest.raises(InputError, match="frame_interval"):
        simulate(make_column(2), ShallowConfig(cell_size=0.1), frame_interval=0)


def test_cells_divide_the_box_and_bodies_cover_parts_of_them() -> None:
    scene = make_scene((1.0, 0.5, 0.5), Body((0.13, 0.0, 0.0), (0.3, 0.21, 0.2), (1.0, -2.0, 0.0)))
    layer = make_start(scene, ShallowConfig(cell_size=0.09))
    assert layer.grid.shape == (11, 6)
    assert layer.grid.sizes == pytest.approx((1 / 11, 0.5 / 6))
    cell = layer.grid.sizes[0] * layer.grid.sizes[1]
    assert layer.thickness.sum() * cell == pytest.approx(0.3 * 0.21 * 0.2)
    assert layer.momentum.sum(axis=1) * cell == pytest.approx([0.3 * 0.21 * 0.2, -2 * 0.3 * 0.21 * 0.2])


def test_the_ground_has_floors_planes_boxes_and_the_tilt_of_gravity() -> None:
    plane = Plane((0.0, 0.2), (math.sin(0.3), math.cos(0.3)), Wall("slip"))
    box = Box((1.2, 0.0), (0.2, 0.15), Wall("stick"))
    scene = make_scene((2.0, 1.0), Body((0.0, 0.2), (0.3, 0.4), STILL), obstacles=(plane, box), gravity=(1.0, -9.0))
    grid = make_grid(scene, 0.1)
    x, _ = grid.centres
    on_box, on_plane = (x > 1.2) & (x < 1.4), x < 0.6
    for k in (1.0, 0.5):
        ground = make_ground(scene, grid, ShallowConfig(cell_size=0.1, earth_pressure=k))
        assert ground.height[on_plane] == pytest.approx(0.2 - math.tan(0.3) * x[on_plane])
        assert ground.height[on_box] == pytest.approx(0.15)
        assert ground.bed[on_box] == pytest.approx(0.15 - x[on_box] / 9 / k)
        assert ground.gravity[on_plane] == pytest.approx(9 * k * math.cos(0.3) ** 2)
        assert ground.gravity[~on_plane] == pytest.approx(9 * k)
        assert ground.friction[on_plane] == pytest.approx(0)
        assert ground.friction[on_box] == pytest.approx(math.tan(math.radians(30)) / k)
        assert ground.friction[-1] == pytest.approx(0.385 / k)
    given = make_ground(scene, grid, ShallowConfig(cell_size=0.1, friction=0.2))
    assert np.unique(given.friction).tolist() == [0.2]


@pytest.mark.parametrize(("k", "moves"), [(1.0, True), (0.5, False)])
def test_earth_pressure_scales_the_push_of_the_surface_not_of_the_slope(k: float, moves: bool) -> None:
    """A heap of slope 0.3 on a floor of 0.25 stays with half the pressure; a level layer on a slope slides as ever."""
    heap = [Body((0.0, 0.03 * level), (1.0 - 0.1 * level, 0.03), STILL) for level in range(10)]
    scene = make_scene((1.5, 0.5), *heap, floor=Wall("friction", 0.25))
    layer = make_start(scene, ShallowConfig(cell_size=0.1, earth_pressure=k))
    before = layer.thickness.copy()
    layer.advance(1.0)
    assert np.array_equal(layer.thickness, before) != moves

    tilted = make_scene((2.0, 0.5), Body(STILL, (2.0, 0.1), STILL), gravity=(1.0, -GRAVITY), floor=Wall("slip"))
    sliding = make_start(tilted, ShallowConfig(cell_size=0.02, earth_pressure=k))
    sliding.advance(0.2)
    assert sliding.momentum[0][50] == pytest.approx(0.1 * 0.2, rel=1e-4)


def test_the_length_that_rain_is_measured_by() -> None:
    def length(position: tuple[float, ...], size: tuple[float, ...]) -> float:
        scene = make_scene((1.0, 0.6, 1.0), Body((*position, 0.0), (*size, 0.5), (0.0, 0.0, 0.0)))
        return spreading_length(scene, scene.bodies[0])

    assert length((0.0, 0.0), (0.3, 0.6)) == pytest.approx(0.3)  # against one wall, from side to side
    assert length((0.2, 0.0), (0.3, 0.6)) == pytest.approx(0.15)  # spreads both ways
    assert length((0.0, 0.0), (0.3, 0.2)) == pytest.approx(0.2)  # in a corner
    assert length((0.0, 0.0), (1.0, 0.6)) == math.inf
