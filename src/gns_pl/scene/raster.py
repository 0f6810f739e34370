"""Rasters on a square grid: read from ESRI ASCII grids (.asc), GeoTIFF (.tif) and NumPy arrays (.npy)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gns_pl.errors import InputError
from gns_pl.scene.checks import checked_number, checked_numbers

Floats = NDArray[np.float64]

SQUARE = 1e-6
"""Relative difference of a cell's edges up to which it is square."""


@dataclass(frozen=True, eq=False)
class Raster:
    """Values in the middles of square cells.

    Attributes:
        values: [NX, NY], x and y rising; NaN where they are missing. [NX] along a profile.
        corner: place of the first value, the middle of the lower left cell [D − 1] [m].
        cell: edge of a cell, the distance of neighbouring values [m].
        crs: coordinate reference system as text, as "EPSG:32632"; "" if unknown.

    Raises:
        InputError: values of another shape, or a cell that is not positive.
    """

    values: Floats
    corner: tuple[float, ...]
    cell: float
    crs: str = ""

    def __post_init__(self) -> None:
        values = checked_array("raster", "values", self.values)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "corner", checked_corner("raster", self.corner, values.ndim))
        object.__setattr__(self, "cell", checked_number("raster", "cell", self.cell, 0.0, above=True))
        object.__setattr__(self, "crs", str(self.crs))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Raster):
            return NotImplemented
        mine, others = (self.corner, self.cell, self.crs), (other.corner, other.cell, other.crs)
        return mine == others and np.array_equal(self.values, other.values, equal_nan=True)

    def __hash__(self) -> int:
        return hash((self.values.shape, self.corner, self.cell, self.crs))

    @property
    def extent(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lower and upper corner of all cells together, half a cell around the first and the last value [m]."""
        return cells_extent(self.values.shape, self.corner, self.cell)

    def cropped(self, lower: Sequence[float], upper: Sequence[float]) -> Raster:
        """Return the least part whose values surround a rectangle, as far as there are any.

        Args:
            lower: its lower corner [D − 1] [m].
            upper: its upper corner [D − 1] [m].

        Raises:
            InputError: nothing is left.
        """
        parts, corner = [], []
        for number, first, low, high in zip(self.values.shape, self.corner, lower, upper, strict=True):
            start = max(math.floor((low - first) / self.cell + 1e-9), 0)
            stop = min(math.ceil((high - first) / self.cell - 1e-9) + 1, number)
            if number > 1 and stop - start == 1:  # a surface needs two values along every axis
                start, stop = (start - 1, stop) if start > 0 else (start, stop + 1)
            if stop <= start:
                raise InputError(
                    f"raster: it reaches {described(*self.extent)} and holds nothing of {described(lower, upper)}."
                )
            parts.append(slice(start, stop))
            corner.append(first + start * self.cell if start else first)
        return Raster(self.values[tuple(parts)], tuple(corner), self.cell, self.crs)


def cells_extent(
    shape: Sequence[int], corner: Sequence[float], cell: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return lower and upper corner of the cells of a raster [m]."""
    lower = tuple(first - cell / 2 for first in corner)
    return lower, tuple(low + number * cell for low, number in zip(lower, shape, strict=True))


def described(lower: Sequence[float], upper: Sequence[float]) -> str:
    """Return a rectangle for a message."""
    sides = zip("xy", lower, upper, strict=False)
    return " and ".join(f"from {axis} = {low:.10g} to {high:.10g} m" for axis, low, high in sides)


def checked_array(owner: str, name: str, values: ArrayLike) -> Floats:
    """Return numbers as a read-only array of one or two axes with at least one entry, or raise an `InputError`."""
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise InputError(f"{owner}: {name} must be an array of numbers.") from None
    if array.ndim not in (1, 2) or array.size == 0:
        raise InputError(f"{owner}: {name} must have the shape [NX, NY], or [NX] along a profile, not {array.shape}.")
    array.setflags(write=False)
    return array


def checked_corner(owner: str, corner: Any, number: int) -> tuple[float, ...]:
    """Return the place of a raster's first value, or raise an `InputError`."""
    numbers = checked_numbers(owner, "corner", corner)
    if len(numbers) != number:
        raise InputError(f"{owner}: corner must have {number} entries as its values have axes, not {len(numbers)}.")
    return numbers


def read_raster(
    path: str | Path, *, corner: Sequence[float] | None = None, cell: float | None = None, crs: str | None = None
) -> Raster:
    """Read a raster; the ending says how.

    Args:
        path: an ESRI ASCII grid (`.asc`; a `.prj` beside it is its reference system), a GeoTIFF (`.tif`, `.tiff`; its
            first band) or a NumPy array (`.npy`, as `Raster.values`).
        corner: place of the first value, the middle of the lower left cell [m]; of an array, which does not know it.
        cell: edge of a cell [m]; of an array.
        crs: coordinate reference system; of a file that does not say it.

    Raises:
        InputError: a file that cannot be read, is no raster, or has cells that are not square or not in metres.
    """
    path = Path(path)
    ending = path.suffix.lower()
    readers = {".asc": _read_ascii, ".tif": _read_geotiff, ".tiff": _read_geotiff}
    if ending not in (*readers, ".npy"):
        raise InputError(f"{path}: a raster is an .asc, .tif or .npy file, not {ending or 'one without an ending'}.")
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    if ending == ".npy":
        if corner is None or cell is None:
            raise InputError(f"{path}: an array does not know its place; give corner and cell besides.")
        raster = Raster(_load_array(path), tuple(corner), cell, crs or "")
    else:
        if corner is not None or cell is not None:
            raise InputError(f"{path}: it knows its place itself; corner and cell are for .npy files.")
        raster = readers[ending](path)
        raster = Raster(raster.values, raster.corner, raster.cell, raster.crs or crs or "")
    _check_metres(path, raster.crs)
    if np.isnan(raster.values).all():
        raise InputError(f"{path}: all its cells are missing.")
    return raster


def _load_array(path: Path) -> NDArray[Any]:
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError, EOFError):
        raise InputError(f"{path}: is not an array of NumPy.") from None


def _read_ascii(path: Path) -> Raster:
    """Read an ESRI ASCII grid: lines of a name and a number, then the values row by row from the north."""
    try:
        words = path.read_text(encoding="ascii").split()
        header: dict[str, float] = {}
        start = 0
        while words[start][0].isalpha() and words[start].lower() != "nan":
            header[words[start].lower()] = float(words[start + 1])
            start += 2
        values = np.array(words[start:], dtype=np.float64)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (UnicodeDecodeError, ValueError, IndexError):
        raise InputError(f"{path}: is not an ESRI ASCII grid.") from None
    missing = {"ncols", "nrows", "cellsize"} - set(header)
    for axis in "xy":
        if not {f"{axis}llcorner", f"{axis}llcenter"} & set(header):
            missing.add(f"{axis}llcorner")
    if missing:
        raise InputError(f"{path}: its header lacks {', '.join(sorted(missing))}.")
    columns, rows, cell = int(header["ncols"]), int(header["nrows"]), header["cellsize"]
    if columns < 1 or rows < 1 or len(values) != columns * rows:
        raise InputError(f"{path}: its header says {columns} × {rows} values, and there are {len(values)}.")
    values[values == header.get("nodata_value", -9999.0)] = np.nan
    corner = [
        header[f"{axis}llcenter"] if f"{axis}llcenter" in header else header[f"{axis}llcorner"] + cell / 2
        for axis in "xy"
    ]
    system = path.with_suffix(".prj")
    crs = system.read_text(encoding="utf-8", errors="replace").strip() if system.is_file() else ""
    return Raster(values.reshape(rows, columns)[::-1].T, tuple(corner), cell, crs)


def _read_geotiff(path: Path) -> Raster:
    """Read the first band of a GeoTIFF whose rows run from north to south, or from south to north."""
    try:
        import rasterio
    except ImportError:
        raise InputError(f"{path}: GeoTIFF needs rasterio; type pip install 'gns_pl[gis]', or give an .asc.") from None
    try:
        with rasterio.open(path) as source:
            values = source.read(1, masked=True).astype(np.float64).filled(np.nan)
            values = values * source.scales[0] + source.offsets[0]  # of heights that are kept as whole numbers
            place, system = source.transform, source.crs
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path}: is not a GeoTIFF that rasterio reads ({error}).") from None
    if place.b or place.d or place.a <= 0 or abs(abs(place.e) / place.a - 1) > SQUARE:
        raise InputError(f"{path}: its cells must be squares along the axes; resample it (gdalwarp -tr 5 5).")
    low = place.f + place.e * values.shape[0] if place.e < 0 else place.f
    values = values[::-1] if place.e < 0 else values
    corner = (place.c + place.a / 2, low + place.a / 2)
    return Raster(values.T, corner, float(place.a), system.to_string() if system is not None else "")


def _check_metres(path: Path, crs: str) -> None:
    """Raise an `InputError` where a length in a reference system is no length on the ground in metres.

    Its unit stands in its well-known text; a number of EPSG has none, and is looked up where rasterio is installed.
    """
    text = _well_known_text(crs)
    cure = "reproject it to a system in metres, such as UTM (gdalwarp -t_srs EPSG:326…)"
    if re.search(r"\b(GEOG|GEOD)", text, re.IGNORECASE) and not re.search(
        r"\b(PROJC|LOCAL_CS|ENG)", text, re.IGNORECASE
    ):
        raise InputError(f"{path}: its coordinates are degrees; {cure}.")
    if re.search("Pseudo-Mercator|Mercator_Auxiliary_Sphere", text, re.IGNORECASE):
        raise InputError(f"{path}: Web Mercator stretches lengths by 1 / cos(latitude); {cure}.")
    for name, size in re.findall(r'\b(?:LENGTH)?UNIT\s*\[\s*"([^"]*)"\s*,\s*([-+.\deE]+)', text, re.IGNORECASE):
        angle = re.search("degree|radian|grad|gon|second|minute", name, re.IGNORECASE)
        if not angle and abs(float(size) - 1) > 1e-9:
            raise InputError(f"{path}: its unit is {name} ({float(size):.7g} m), of places or heights; {cure}.")


def _well_known_text(crs: str) -> str:
    """Return a reference system as well-known text where rasterio knows it, else as it is."""
    try:
        import rasterio
    except ImportError:
        return crs
    try:
        with rasterio.Env():  # what GDAL has to say goes to Python's log
            return str(rasterio.crs.CRS.from_user_input(crs).to_wkt()) if crs else ""
    except rasterio.errors.CRSError:
        return crs
