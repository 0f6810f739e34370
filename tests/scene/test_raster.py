"""Rasters are read where and how high they are; what is none is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene.raster import Raster, read_raster

VALUES = np.array([[1.5, 4.0], [2.25, 5.0], [3.0, np.nan]])
"""[x, y], as below with the north above."""

GRID = """ncols 3
nrows 2
xllcorner 600000.5
yllcorner 5100000
cellsize 10
NODATA_value -9999
4 5 -9999
1.5 2.25 3
"""


@pytest.fixture
def grid(tmp_path: Path) -> Path:
    (tmp_path / "hill.asc").write_text(GRID)
    return tmp_path / "hill.asc"


def test_an_ascii_grid_lies_with_its_first_row_in_the_north(grid: Path) -> None:
    raster = read_raster(grid)
    assert np.array_equal(raster.values, VALUES, equal_nan=True)
    assert (raster.corner, raster.cell, raster.crs) == ((600005.5, 5100005.0), 10.0, "")
    assert raster.extent == ((600000.5, 5100000.0), (600030.5, 5100020.0))
    centred = GRID.replace("xllcorner 600000.5", "XLLCENTER 600005.5").replace("NODATA_value -9999\n", "")
    grid.write_text(centred)
    grid.with_suffix(".prj").write_text('PROJCS["UTM zone 32N"]\n')
    again = read_raster(grid)
    assert again == Raster(raster.values, raster.corner, raster.cell, 'PROJCS["UTM zone 32N"]') and again != raster


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("cellsize 10\n", "", "header lacks cellsize"),
        ("xllcorner 600000.5\n", "", "header lacks xllcorner"),
        ("ncols 3", "ncols 4", "says 4 × 2 values, and there are 6"),
        ("1.5", "high", "is not an ESRI ASCII grid"),
        ("cellsize 10", "cellsize -10", "cell must be a finite number above 0"),
        (GRID, "", "is not an ESRI ASCII grid"),
        ("4 5 -9999\n1.5 2.25 3", "-9999 -9999 -9999 -9999 -9999 -9999", "all its cells are missing"),
    ],
)
def test_what_is_no_grid_is_told(grid: Path, old: str, new: str, message: str) -> None:
    grid.write_text(GRID.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_raster(grid)


def test_a_grid_in_degrees_is_refused(grid: Path) -> None:
    grid.with_suffix(".prj").write_text('GEOGCS["WGS 84"]')
    with pytest.raises(InputError, match="degrees; reproject"):
        read_raster(grid)


FEET = 'PROJCS["NC",GEOGCS["NAD83",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",0.304800609601219]]'
HEIGHTS_IN_FEET = 'COMPD_CS["both",PROJCS["UTM",UNIT["metre",1]],VERT_CS["NAVD88",UNIT["foot",0.3048]]]'


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (FEET, r"its unit is US survey foot \(0\.3048006 m\), of places or heights; reproject it"),
        (HEIGHTS_IN_FEET, r"its unit is foot \(0\.3048 m\)"),
        ('PROJCS["WGS_1984_Web_Mercator_Auxiliary_Sphere",UNIT["Meter",1.0]]', "stretches lengths by 1 / cos"),
        ('COMPD_CS["both",GEOGCS["WGS 84",UNIT["degree",0.0174532925199433]],VERT_CS["h",UNIT["metre",1]]]', "degrees"),
    ],
)
def test_lengths_that_are_none_in_metres_are_refused(grid: Path, system: str, message: str) -> None:
    grid.with_suffix(".prj").write_text(system)
    with pytest.raises(InputError, match=message):
        read_raster(grid)


@pytest.mark.parametrize(("code", "message"), [("2264", "US survey foot"), ("4326", "degrees"), ("3857", "Mercator")])
def test_a_number_of_epsg_is_looked_up(tmp_path: Path, grid: Path, code: str, message: str) -> None:
    pytest.importorskip("rasterio")
    np.save(tmp_path / "hill.npy", VALUES)
    with pytest.raises(InputError, match=message):
        read_raster(tmp_path / "hill.npy", corner=(1.0, 2.0), cell=5.0, crs=f"EPSG:{code}")
    with pytest.raises(InputError, match=message):
        read_raster(grid, crs=f"EPSG:{code}")


def test_an_array_is_told_its_place(tmp_path: Path) -> None:
    path = tmp_path / "hill.npy"
    np.save(path, VALUES.astype(np.float32))
    raster = read_raster(path, corner=(1.0, 2.0), cell=5.0, crs="EPSG:32632")
    assert raster == Raster(VALUES, (1.0, 2.0), 5.0, "EPSG:32632")
    with pytest.raises(InputError, match="give corner and cell"):
        read_raster(path)
    with pytest.raises(InputError, match="corner must have 2 entries"):
        read_raster(path, corner=(1.0,), cell=5.0)
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="is not an array of NumPy"):
        read_raster(path, corner=(1.0, 2.0), cell=5.0)


def test_other_files_are_told(grid: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_raster(tmp_path / "no.asc")
    with pytest.raises(InputError, match=r"is an \.asc, \.tif or \.npy file, not \.png"):
        read_raster(tmp_path / "hill.png")
    with pytest.raises(InputError, match="knows its place itself"):
        read_raster(grid, cell=5.0)


@pytest.mark.parametrize("upwards", [False, True])
def test_a_geotiff_is_the_grid_it_was_written_from(tmp_path: Path, upwards: bool) -> None:
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "hill.tif"
    rows = np.nan_to_num(VALUES.T, nan=-9999.0)
    place = rasterio.Affine(10, 0, 600000.5, 0, 10, 5100000) if upwards else None
    place = place or rasterio.Affine(10, 0, 600000.5, 0, -10, 5100020)
    settings = {"driver": "GTiff", "width": 3, "height": 2, "count": 1, "dtype": "float64", "nodata": -9999.0}
    with rasterio.open(path, "w", **settings, crs="EPSG:32632", transform=place) as file:
        file.write(rows if upwards else rows[::-1], 1)
    assert read_raster(path) == Raster(VALUES, (600005.5, 5100005.0), 10.0, "EPSG:32632")
    with rasterio.open(path, "w", **settings | {"dtype": "int16"}, crs="EPSG:32632", transform=place) as file:
        file.scales, file.offsets = (0.5,), (400.0,)
        file.write((rows if upwards else rows[::-1]).astype(np.int16), 1)
    assert np.array_equal(read_raster(path).values, 400 + np.trunc(VALUES) / 2, equal_nan=True)
    with rasterio.open(path, "w", **settings, crs="EPSG:4326", transform=place) as file:
        file.write(rows, 1)
    with pytest.raises(InputError, match="degrees; reproject"):
        read_raster(path)
    with rasterio.open(path, "w", **settings, transform=rasterio.Affine(10, 0, 0, 0, -5, 0)) as file:
        file.write(rows, 1)
    with pytest.raises(InputError, match="must be squares"):
        read_raster(path)


def test_no_geotiff_is_told(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    (tmp_path / "hill.tif").write_text("no picture")
    with pytest.raises(InputError, match="is not a GeoTIFF"):
        read_raster(tmp_path / "hill.tif")


def test_a_crop_keeps_values_on_all_sides() -> None:
    raster = Raster(np.arange(35.0).reshape(5, 7), (10.0, 20.0), 2.0)
    part = raster.cropped((12.5, 26.0), (15.0, 40.0))
    assert (part.corner, part.values.tolist()) == ((12.0, 26.0), raster.values[1:4, 3:].tolist())
    assert raster.cropped(*raster.extent) == raster
    assert raster.cropped((9.0, 20.1), (9.5, 20.2)).values.shape == (2, 2)
    with pytest.raises(InputError, match="holds nothing of from x = 100 to 110 m"):
        raster.cropped((100.0, 20.0), (110.0, 30.0))
