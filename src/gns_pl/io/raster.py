"""Rasters for a geographic information system: ESRI's ASCII grids, and GeoTIFF where rasterio is installed.

`scene.read_raster` reads both. Files hold rows from north to south, and places in float64.
"""

from __future__ import annotations

import io
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.io.atomic import atomic_path, write_atomically
from gns_pl.scene import Raster, Scene

if TYPE_CHECKING:
    from rasterio.crs import CRS

NODATA = -9999.0
"""Of cells without a value."""


def write_raster(path: Path, raster: Raster) -> list[Path]:
    """Write a raster as `path`.asc, and as `path`.tif where rasterio is installed, and return the files.

    Args:
        path: without an ending.
        raster: [X, Y] in the coordinates of the map. GeoTIFF alone has a place for its reference system.

    Raises:
        InputError: a reference system that is none.
        StorageError: the disk refuses.
    """
    reference = read_crs(raster.crs)
    rows = np.where(np.isnan(raster.values), NODATA, raster.values).T[::-1].astype(np.float32)
    files = [path.with_name(f"{path.name}.asc")]
    (west, south), (_, north) = raster.extent
    header = (
        f"ncols {rows.shape[1]}\nnrows {rows.shape[0]}\n"
        f"xllcorner {west!r}\nyllcorner {south!r}\n"
        f"cellsize {raster.cell!r}\nNODATA_value {NODATA:g}\n"
    )
    text = io.StringIO()
    np.savetxt(text, rows, fmt="%.8g")
    write_atomically(files[0], (header + text.getvalue()).encode("ascii"))
    if find_spec("rasterio") is not None:
        files.append(path.with_name(f"{path.name}.tif"))
        _write_geotiff(files[1], rows, (west, north), raster.cell, reference)
    return files


def read_crs(crs: str) -> CRS | None:
    """Return a coordinate reference system; None without one, or without rasterio.

    Raises:
        InputError: there is no such system.
    """
    if not crs or find_spec("rasterio") is None:
        return None
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(f"crs {crs!r} names no coordinate reference system; give one as EPSG:32617.") from error


def scene_crs(scene: Scene) -> str:
    """Return the coordinate reference system of a scene's terrain as text, "" where it has none."""
    return "" if scene.terrain is None else scene.terrain.crs


def _write_geotiff(
    path: Path, rows: NDArray[np.float32], north_west: tuple[float, float], cell: float, crs: CRS | None
) -> None:
    import rasterio
    from rasterio.transform import Affine

    profile = {
        "driver": "GTiff",
        "height": rows.shape[0],
        "width": rows.shape[1],
        "count": 1,
        "dtype": "float32",
        "nodata": NODATA,
        "transform": Affine(cell, 0.0, north_west[0], 0.0, -cell, north_west[1]),
        "crs": crs,
        "compress": "deflate",
    }
    with atomic_path(path) as temporary, rasterio.open(temporary, "w", **profile) as file:
        file.write(rows, 1)
