"""Maps of a run in files: the volume is the particles', on the terrain's own cells, in the coordinates of the map."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.maps import map_rows, maps_of, write_maps
from gns_pl.evaluation.run_report import ReportedRun, write_report
from gns_pl.evaluation.simulation import simulate_and_describe
from gns_pl.fields import ParticleType
from gns_pl.io import read_trajectory, write_trajectory
from gns_pl.metrics.rasters import map_grid
from gns_pl.scene import read_raster, write_scene
from gns_pl.trajectory import Trajectory
from tests.evaluation.made_up import SPACING, column, moved, spreading, standing
from tests.evaluation.test_simulation import config, told
from tests.viz.test_maps import ORIGIN, on_terrain


def sliding(frames: int = 9) -> Trajectory:
    """The body on the terrain slides by 0.4 m along x."""
    offset = np.linspace((0, 0, 0), (0.4, 0, -0.08), frames)
    return moved(standing(on_terrain(), frames, SPACING), offset)


def test_rasters_of_a_file_are_those_of_the_run_in_memory(tmp_path: Path) -> None:
    flow = sliding()
    types = flow.particle_type.copy()
    types[:5] = ParticleType.KINEMATIC
    flow = replace(flow, particle_type=types)
    write_trajectory(tmp_path / "run.h5", flow)
    of_file, of_run = maps_of(tmp_path / "run.h5"), maps_of(flow)
    for name, values in of_run.rasters().items():
        np.testing.assert_array_equal(of_file.rasters()[name], values)
    assert of_run.deposit.sum() * 0.01 == pytest.approx(float(flow.volume()[5:].sum()), rel=1e-5)


def test_files_hold_the_volume_where_it_lies(tmp_path: Path) -> None:
    flow = sliding()
    maps = maps_of(flow)
    assert maps.grid == map_grid(flow.scene, flow.spacing)
    files = write_maps(maps, flow.scene, tmp_path / "maps", name="slide", title="slide")
    names = {path.name for path in files}
    assert {f"slide_{name}.asc" for name in maps.rasters()} <= names
    assert {"slide_map.png", "slide_maps.png", "slide_outlines.geojson"} <= names
    deposit = read_raster(tmp_path / "maps" / "slide_deposit.asc")
    assert deposit.values.sum() * deposit.cell**2 == pytest.approx(float(flow.volume().sum()), rel=1e-5)
    # On the terrain's own cells: the middles are at whole cells from its first one, in the coordinates of the map.
    corner = np.array(deposit.corner) - np.array(ORIGIN[:2])
    cells = (corner - flow.scene.terrain.corner) / 0.1
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-5)
    x = deposit.corner[0] + deposit.cell * np.arange(deposit.values.shape[0]) - ORIGIN[0]
    assert x @ deposit.values.sum(axis=1) / deposit.values.sum() == pytest.approx(
        float(flow.position[-1, :, 0].mean()), abs=1e-4
    )
    arrival = read_raster(tmp_path / "maps" / "slide_arrival_time.asc").values
    assert np.isnan(arrival[-1]).all() and np.nanmin(arrival) == 0
    collection = json.loads((tmp_path / "maps" / "slide_outlines.geojson").read_text())
    assert collection["crs"]["properties"]["name"].endswith("EPSG::32616")
    outlines = {each["properties"]["outline"]: each for each in collection["features"]}
    area = {name: each["properties"]["area_m2"] for name, each in outlines.items()}
    # It slid by four cells, so its outline is that of the release, four cells on.
    assert area["deposit"] == pytest.approx(area["release"], rel=1e-3) and area["runout"] > 1.5 * area["release"]
    rings = {name: np.array(each["geometry"]["coordinates"][0][0]) for name, each in outlines.items()}
    ends = {name: (ring[:, 0].min() - ORIGIN[0], ring[:, 0].max() - ORIGIN[0]) for name, ring in rings.items()}
    assert ends["release"] == pytest.approx((0.1, 0.5), abs=0.1)
    assert ends["deposit"] == pytest.approx(np.add(ends["release"], 0.4), abs=1e-3)
    assert ends["runout"] == pytest.approx((ends["release"][0], ends["deposit"][1]), abs=1e-3)


def test_geotiff_knows_its_reference_system(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    flow = sliding(3)
    maps = maps_of(flow)
    write_maps(maps, flow.scene, tmp_path, name="slide", figures=False)
    with rasterio.open(tmp_path / "slide_deposit.tif") as file:
        assert file.crs.to_epsg() == 32616
        assert file.bounds.left == pytest.approx(ORIGIN[0] + maps.grid.lower[0], abs=1e-6)
        assert file.bounds.bottom == pytest.approx(ORIGIN[1] + maps.grid.lower[1], abs=1e-6)
    assert not list(tmp_path.glob("*.png"))


def test_particles_that_show_a_layer_of_unknown_speed_have_no_velocity(tmp_path: Path) -> None:
    flow = replace(sliding(3), provenance={"solver": "shallow-k0", "shallow": {"cell_size": 0.1}})
    maps = maps_of(flow)
    assert maps.max_velocity is None and "max_velocity" not in maps.rasters()
    assert "velocity none, since these particles show a layer" in map_rows(maps, flow.scene)[1][1]
    files = write_maps(maps, flow.scene, tmp_path, name="layer")
    assert tmp_path / "layer_maps.png" in files and not any("velocity" in path.name for path in files)


def test_a_flow_at_the_edge_of_the_box_is_told() -> None:
    scene = on_terrain()
    narrow = replace(scene.bodies[0], position=(0.1, 0.2, 0.3), size=(0.3, 0.1, 0.2))
    still = standing(scene.replace(bodies=(narrow,)), 9, SPACING)
    for way, at_edge in ((0.4, False), (1.1, True)):
        flow = moved(still, np.linspace((0, 0, 0), (way, 0, -0.2 * way), 9))
        assert ("edge" in dict(map_rows(maps_of(flow), flow.scene))) == at_edge


def test_a_report_shows_the_maps(tmp_path: Path) -> None:
    flow = spreading(frames=4)
    options = {"animation": {"num_frames": 2, "width": 300}, "maps": True, "reached": 0.02}
    files = write_report({"column": ReportedRun(flow, "made up")}, tmp_path, **options)
    assert tmp_path / "maps" / "column_deposit.asc" in files
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png") == 5 and "The deposit on the map" in page


def test_simulate_writes_maps_beside_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(column().replace(duration=0.03), tmp_path / "small.yaml")
    settings = (f"scene={tmp_path / 'small.yaml'}", "solver=shallow-k0", f"out={tmp_path / 'out'}", "maps=true")
    (path,) = simulate_and_describe(config("simulate", *settings, "reporting.figures=false", "reporting.reached=0.03"))
    text = told(capsys)
    assert "reached where the thickness is 0.03 m or more" in text
    deposit = read_raster(tmp_path / "out" / "column" / "maps" / "column_deposit.asc")
    volume = float(read_trajectory(path).volume().sum())
    assert deposit.values.sum() * deposit.cell**2 == pytest.approx(volume, rel=1e-4)


@pytest.mark.parametrize(
    ("options", "dim", "sentence"),
    [
        (("reporting.reached=-1",), 3, r"reporting\.reached must be a thickness above 0 m, or null, not -1"),
        ((), 2, "scene 'column' has two dimensions, so it has no map; leave maps= out"),
    ],
)
def test_what_has_no_map_is_refused_before_the_run(
    tmp_path: Path, options: tuple[str, ...], dim: int, sentence: str
) -> None:
    write_scene(column(dim), tmp_path / "small.yaml")
    settings = (f"scene={tmp_path / 'small.yaml'}", "solver=shallow-k0", f"out={tmp_path / 'out'}", "maps=true")
    with pytest.raises(InputError, match=sentence):
        simulate_and_describe(config("simulate", *settings, *options))
    assert not (tmp_path / "out").exists()


def test_a_reference_system_that_is_none_is_refused_before_the_run(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    scene = on_terrain()
    write_scene(scene.replace(terrain=scene.terrain.replace(crs="the moon")), tmp_path / "small.yaml")
    settings = (f"scene={tmp_path / 'small.yaml'}", "solver=mpm", f"out={tmp_path / 'out'}", "maps=true")
    with pytest.raises(InputError, match="'the moon' names no coordinate reference system"):
        simulate_and_describe(config("simulate", *settings))
    assert not (tmp_path / "out").exists()
