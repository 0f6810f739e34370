"""Map figures, by what their pixels and axes show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gns_pl.metrics.rasters import MapGrid, compute_maps, map_grid
from gns_pl.scene import Box, Plane, Scene, Terrain, Wall
from gns_pl.viz import write_paraview
from gns_pl.viz.ground import ground_height
from gns_pl.viz.maps import draw_ground, layers, lines, plot_map
from tests.evaluation.made_up import SPACING, column, spreading, standing

ROUGH, ORIGIN = Wall("friction", 0.5), (736_000.25, 4_051_000.5, 300.0)


def on_terrain() -> Scene:
    """A slope down along x on cells of 0.1 m, of which the box does not need the outer ones, far from zero."""
    heights = np.add.outer(0.02 * (20 - np.arange(20)), 0.001 * np.arange(9.0))
    terrain = Terrain(heights, (-0.15, -0.15), 0.1, ROUGH, "EPSG:32616")
    [body] = column().bodies
    body = type(body)((0.1, 0.0, 0.3), (0.4, 0.5, 0.2), (0.0, 0.0, 0.0))
    return column().replace(terrain=terrain, bodies=(body,), origin=ORIGIN)


def test_cells_are_those_of_the_terrain_under_the_box() -> None:
    scene = on_terrain()
    grid = map_grid(scene, 0.3)
    assert grid.cell == 0.1 and grid.shape == (17, 7)
    # The first middle is at or below the edge of the box, the last at or above; they are middles of the terrain.
    x, y = grid.centres
    assert (x[0], y[0]) == pytest.approx((-0.05, -0.05)) and (x[-1], y[-1]) == pytest.approx((1.55, 0.55))
    np.testing.assert_allclose(ground_height(scene, grid), scene.terrain.heights[1:18, 1:8])
    raster = grid.raster(ground_height(scene, grid), ORIGIN, "EPSG:32616")
    assert raster.corner == pytest.approx((ORIGIN[0] - 0.05, ORIGIN[1] - 0.05), abs=1e-9)


def test_ground_is_floor_slope_and_boxes() -> None:
    slope = Plane((0.5, 0.0, 0.0), (0.5, 0.0, 1.0), ROUGH)  # falls by a half, and meets the floor at x = 0.5
    wall = Plane((1.4, 0.0, 0.0), (-1.0, 0.0, 0.1), ROUGH)
    scene = column().replace(obstacles=(slope, wall, Box((0.9, 0.2, 0.0), (0.2, 0.1, 0.3), ROUGH)))
    grid = MapGrid((0.0, 0.0), 0.1, (15, 5))
    height = ground_height(scene, grid)
    np.testing.assert_allclose(height[:5, 0], 0.5 * (0.5 - grid.centres[0][:5]))
    assert (height[5:9] == 0).all() and height[9, 2] == height[10, 2] == 0.3 and height[9, 1] == 0


def test_figures_are_in_the_coordinates_of_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    seen: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *some, **more: (seen.append(self), save(self, *some, **more)))
    flow = spreading()
    maps, scene = compute_maps(flow), flow.scene
    shown = list(layers(maps).values())
    plot_map(shown, lines(maps), maps.grid, ground_height(scene, maps.grid), [tmp_path / "m.png"], origin=ORIGIN[:2])
    assert (tmp_path / "m.png").stat().st_size > 10_000
    panels = [axes for axes in seen[0].axes if axes.get_title("left")]
    assert [axes.get_title("left")[:9] for axes in panels] == ["Thickness", "Largest t", "Time of a", "Largest v"]
    for axes in panels:
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        assert left == pytest.approx(ORIGIN[0], abs=1e-6) and bottom == pytest.approx(ORIGIN[1], abs=1e-6)
        assert right <= ORIGIN[0] + 1.5 + 1e-6 and top <= ORIGIN[1] + 0.5 + 1e-6
        outline = np.concatenate([line.get_xydata() for line in axes.lines])
        assert (outline >= np.array(ORIGIN[:2]) - 1e-6).all() and outline.max(axis=0)[1] <= ORIGIN[1] + 0.5 + 1e-6
    deposit = np.ma.getmaskarray(panels[0].images[1].get_array())
    thin = (maps.deposit < maps.reached)[: deposit.shape[1], : deposit.shape[0]]
    np.testing.assert_array_equal(deposit[::-1].T, thin)  # the ground shows where it is thinner


def test_a_slope_towards_the_light_is_brighter() -> None:
    """Light comes from the north-west: ground that falls towards it is brighter than ground that falls away."""
    from matplotlib.figure import Figure

    grid = MapGrid((0.0, 0.0), 1.0, (8, 8))
    x, y = np.meshgrid(*grid.centres, indexing="ij")
    shades = []
    for sign in (1.0, -1.0):
        axes = Figure().subplots()
        draw_ground(axes, grid, sign * 0.5 * (x - y))  # +: rises to the south-east, so it falls to the north-west
        shades.append(float(np.mean(axes.images[0].get_array())))
    assert shades[0] > shades[1] + 0.1


def test_paraview_shows_the_ground_beside_the_points(tmp_path: Path) -> None:
    pv = pytest.importorskip("pyvista")
    scene = on_terrain()
    path = write_paraview(tmp_path, standing(scene, spacing=SPACING), name="flow")
    reader = pv.PVDReader(path)
    reader.set_active_time_value(reader.time_values[2])
    points, ground = reader.read()
    assert points.n_points == points.n_verts and ground.n_points == 20 * 9 and ground.n_cells == 19 * 8
    assert points.points[:, 2].min() > 300 and ground.points.dtype == np.float64
    x, y, z = np.asarray(ground.points).reshape(20, 9, 3).transpose(2, 0, 1)
    np.testing.assert_allclose(x[:, 0], ORIGIN[0] - 0.15 + 0.1 * np.arange(20), rtol=0, atol=1e-6)
    np.testing.assert_allclose(y[0], ORIGIN[1] - 0.15 + 0.1 * np.arange(9), rtol=0, atol=1e-6)
    np.testing.assert_allclose(z, scene.terrain.heights + 300.0)
    np.testing.assert_allclose(ground["height"], z.ravel())
    assert ground.area == pytest.approx(1.9 * 0.8 * np.sqrt(1 + 0.2**2 + 0.01**2), rel=1e-3)
    write_paraview(tmp_path, standing(), name="flow")
    assert not (tmp_path / "flow_ground.vtp").exists()  # of a scene without terrain none is left
