"""Maps of a run: no volume is lost, and what slides arrives when its front does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.metrics.outlines import area_of, polygons_above
from gns_pl.metrics.rasters import FlowMaps, MapGrid, compute_maps, map_grid
from gns_pl.scene import Body
from gns_pl.trajectory import Trajectory
from tests.evaluation.made_up import SPACING, column, moved, spreading, standing


def block(frames: int, dt: float) -> Trajectory:
    """A block of 0.4 m x 0.2 m and 0.2 m height, its front at 0.6 m, in a box of 1.5 m x 0.5 m."""
    body = Body((0.2, 0.15, 0.0), (0.4, 0.2, 0.2), (0.0, 0.0, 0.0))
    return standing(column().replace(bodies=(body,)), frames, dt=dt)


def volume(maps: FlowMaps, name: str = "deposit") -> float:
    return float(getattr(maps, name).sum() * maps.grid.cell**2)


@pytest.mark.parametrize("cell", [0.013, 0.05, 0.1, 0.4])
def test_the_rasters_hold_the_particles_volume_on_any_cells(cell: float) -> None:
    """Also of particles at the wall, beyond it, and on a grid that is smaller than the spread of one of them."""
    flow = spreading()
    flow = moved(flow, np.linspace((0, 0, 0), (1.2, 0.3, 0), flow.num_frames))  # in part through two walls
    grid = MapGrid((0.0, 0.0), cell, (int(np.ceil(1.5 / cell)), int(np.ceil(0.5 / cell))))
    maps = compute_maps(flow, grid=grid)
    assert volume(maps) == pytest.approx(0.4 * 0.5 * 0.2, rel=1e-6)
    assert volume(maps, "release") == pytest.approx(0.4 * 0.5 * 0.2, rel=1e-6)


@pytest.mark.parametrize("cell", [0.025, 0.05, 0.1])
def test_a_layer_has_one_thickness_up_to_the_walls(cell: float) -> None:
    layer = Body((0.0, 0.0, 0.0), (1.5, 0.5, 0.2), (0.0, 0.0, 0.0))
    flow = standing(column().replace(bodies=(layer,)), 2)
    maps = compute_maps(flow, grid=MapGrid((0.0, 0.0), cell, (round(1.5 / cell), round(0.5 / cell))))
    np.testing.assert_allclose(maps.deposit, 0.2, rtol=1e-5)
    np.testing.assert_allclose(maps.max_thickness, 0.2, rtol=1e-5)
    assert maps.area() == pytest.approx(0.75) and not maps.max_velocity.any() and not maps.arrival_time.any()


def test_cells_are_two_spacings_and_divide_the_shorter_side() -> None:
    grid = map_grid(column(), SPACING)
    assert grid == MapGrid((0.0, 0.0), 0.1, (15, 5))
    grid = map_grid(column(), 0.06)
    assert grid.cell == 0.5 / 4 and grid.shape == (12, 4)
    assert map_grid(column(), 3.0).shape == (3, 1)
    with pytest.raises(InputError, match="has two dimensions, so it has no map; leave maps= out"):
        map_grid(column(2), SPACING)


@pytest.mark.parametrize(("speed", "acceleration"), [(1.0, 0.0), (0.0, 2.0)])
def test_a_block_that_slides_arrives_when_its_front_does(speed: float, acceleration: float) -> None:
    """x = v t + a t² / 2: where half of its thickness counts as reached, a cell is reached when the front is there."""
    dt, frames = 0.005, 141
    time = dt * np.arange(frames)
    way = speed * time + acceleration * time**2 / 2
    flow = moved(block(frames, dt), np.stack([way, 0 * way, 0 * way], axis=1))
    flow = replace(flow, initial_velocity=np.full_like(flow.initial_velocity, [speed, 0.0, 0.0]))
    maps = compute_maps(flow, reached=0.1)
    x, y = maps.grid.centres
    row = int(np.argmin(np.abs(y - 0.25)))
    ahead = (x > 0.6) & (x < 0.6 + way[-1])
    distance = x[ahead] - 0.6
    exact = distance if speed else np.sqrt(2 * distance / acceleration)
    np.testing.assert_allclose(maps.arrival_time[ahead, row], exact, atol=2e-4)
    assert (maps.arrival_time[(x > 0.3) & (x < 0.5), row] == 0).all()
    assert np.isnan(maps.arrival_time[x > 0.75 + way[-1], row]).all()
    # It is fastest where it is last; every cell on its way saw its whole thickness.
    fastest = maps.max_velocity[int((0.5 + way[-1]) / maps.grid.cell), row]
    assert fastest == pytest.approx(speed + acceleration * (time[-1] - dt / 2), rel=1e-4)
    np.testing.assert_allclose(maps.max_thickness[(x > 0.45) & (x < 0.4 + way[-1]), row], 0.2, rtol=1e-3)
    assert maps.deposit[(x > 0.1) & (x < 0.2 + way[-1] - 0.15), row] == pytest.approx(0.0, abs=1e-12)


def test_a_body_that_falls_is_as_fast_as_the_fall(dt: float = 0.01) -> None:
    time = dt * np.arange(21)
    fall = np.stack([0 * time, 0 * time, -9.81 * time**2 / 2], axis=1)
    maps = compute_maps(moved(block(21, dt), fall))
    assert maps.max_velocity.max() == pytest.approx(9.81 * (time[-1] - dt / 2), rel=1e-5)
    np.testing.assert_allclose(maps.deposit, maps.release, atol=1e-12)


def test_frames_that_are_not_finite_are_left_out() -> None:
    flow = spreading()
    broken = flow.position.copy()
    broken[20, 3] = np.nan
    found, whole = (
        compute_maps(replace(flow, position=broken)),
        compute_maps(replace(flow, position=flow.position[:20])),
    )
    np.testing.assert_array_equal(found.deposit, whole.deposit)
    np.testing.assert_array_equal(found.max_velocity, whole.max_velocity)


def test_polygons_are_where_the_raster_is_above_a_level() -> None:
    """A cone of height 1 and radius 1 is above h in a circle of radius 1 − h; a ring has a hole."""
    grid = MapGrid((100.0, -50.0), 0.02, (120, 110))
    x, y = np.meshgrid(*grid.centres, indexing="ij")
    radius = np.hypot(x - 101.2, y + 48.9)
    [[ring]] = polygons_above(np.maximum(1 - radius, 0.0), grid, 0.25)
    assert area_of([[ring]]) == pytest.approx(np.pi * 0.75**2, rel=1e-3)
    np.testing.assert_allclose(np.hypot(*(ring - (101.2, -48.9)).T), 0.75, atol=2e-3)
    [[outer, hole]] = polygons_above(np.maximum(1 - 2 * np.abs(radius - 0.6), 0.0), grid, 0.5)
    assert area_of([[outer, hole]]) == pytest.approx(np.pi * (0.85**2 - 0.35**2), rel=1e-3)
    assert (outer[0] == outer[-1]).all() and area_of([[outer]]) > 0 > area_of([[hole]])


def test_polygons_end_at_the_edge_of_the_grid_and_none_is_above_the_top() -> None:
    grid = MapGrid((0.0, 0.0), 1.0, (4, 3))
    [[ring]] = polygons_above(np.ones((4, 3)), grid, 0.5)
    assert area_of([[ring]]) == pytest.approx(12, rel=1e-5)
    np.testing.assert_allclose([ring.min(axis=0), ring.max(axis=0)], [(0, 0), (4, 3)], atol=1e-5)
    assert polygons_above(np.ones((4, 3)), grid, 1.5) == []
    assert polygons_above(np.zeros((4, 3)), grid, 0.5) == []
