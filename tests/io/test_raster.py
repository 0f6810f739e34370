"""Rasters and outlines for a geographic information system, read back by others' readers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.io.geojson import write_outlines
from gns_pl.io.raster import NODATA, write_raster
from gns_pl.scene import Raster, read_raster

CORNER, CELL = (736_231.123456789, 4_051_000.25), 27.3


def raster(values: np.ndarray, crs: str = "") -> Raster:
    """The south-west corner of the first cell is `CORNER`."""
    return Raster(values, (CORNER[0] + CELL / 2, CORNER[1] + CELL / 2), CELL, crs)


@pytest.fixture
def values() -> np.ndarray:
    values = np.random.default_rng(3).random((5, 3)) * 40
    values[0, 2] = np.nan
    return values


def test_an_ascii_grid_is_read_back_as_it_was(tmp_path: Path, values: np.ndarray) -> None:
    """North first, the corner to a nanometre, values as float32."""
    path = write_raster(tmp_path / "deposit", raster(values))[0]
    assert path.name == "deposit.asc"
    lines = path.read_text().splitlines()
    header = dict(line.split() for line in lines[:6])
    assert (header["ncols"], header["nrows"]) == ("5", "3")
    assert (float(header["xllcorner"]), float(header["yllcorner"])) == pytest.approx(CORNER, abs=1e-9) and float(
        header["cellsize"]
    ) == CELL
    rows = np.loadtxt(lines[6:])
    assert rows[0, 0] == float(header["NODATA_value"]) == NODATA
    np.testing.assert_allclose(np.where(rows == NODATA, np.nan, rows)[::-1].T, values, rtol=1e-6)


def test_geotiff_and_ascii_grid_lie_where_they_belong(tmp_path: Path, values: np.ndarray) -> None:
    rasterio = pytest.importorskip("rasterio")
    text, tif = write_raster(tmp_path / "deposit", raster(values, "EPSG:32616"))
    for path in (text, tif):
        with rasterio.open(path) as file:
            found = file.read(1, masked=True)
            # The middle of the south-west cell is half a cell from the corner.
            x, y = file.xy(2, 0)
            assert (x, y) == pytest.approx((CORNER[0] + CELL / 2, CORNER[1] + CELL / 2), abs=1e-6)
            assert file.nodata == NODATA and found.mask.sum() == 1 and found.mask[0, 0]
            np.testing.assert_allclose(found.filled(np.nan)[::-1].T, values, rtol=1e-6)
    with rasterio.open(tif) as file:
        assert file.crs.to_epsg() == 32616 and file.transform.a == CELL and file.transform.e == -CELL
        assert (file.transform.c, file.transform.f) == pytest.approx((CORNER[0], CORNER[1] + 3 * CELL), abs=1e-9)
    for path in (text, tif):
        back = read_raster(path)
        assert back.corner == pytest.approx(raster(values).corner, abs=1e-9)
        np.testing.assert_allclose(back.values, values, rtol=1e-6)
    with pytest.raises(InputError, match="crs 'the moon' names no coordinate reference system; give one as EPSG:"):
        write_raster(tmp_path / "none", raster(values, "the moon"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["deposit.asc", "deposit.tif"]


def test_outlines_are_features_of_a_collection(tmp_path: Path) -> None:
    square = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)], dtype=np.float64) + CORNER
    hole = (square - CORNER)[::-1] / 4 + CORNER + 1
    path = write_outlines(
        tmp_path / "o.geojson", [({"outline": "runout"}, [[square, hole], [square + 9]])], "epsg:32616"
    )
    content = json.loads(path.read_text())
    assert content["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::32616"
    [feature] = content["features"]
    assert feature["properties"] == {"outline": "runout"} and feature["geometry"]["type"] == "MultiPolygon"
    assert [len(polygon) for polygon in feature["geometry"]["coordinates"]] == [2, 1]
    np.testing.assert_array_equal(feature["geometry"]["coordinates"][0][1], hole)
    assert "crs" not in json.loads(write_outlines(tmp_path / "p.geojson", [], "my own").read_text())
