"""A real slope for docs/terrain.md: ground as an ESRI ASCII grid, a release as GeoJSON, and a scene of both.

    python examples/terrain.py runs/terrain    # elevation.asc, release.geojson, landslide.yaml, in a second

The elevation model is the one that matplotlib ships, of the Jacksboro fault in Tennessee (USGS, 3 arc seconds). It is
in degrees; a map in metres is made of it by the equidistant cylindrical projection of a sphere. Release, material and
friction are made up: nothing is known to have slid here.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
import yaml

from gns_pl.io.raster import write_raster
from gns_pl.scene import Raster

RADIUS, LATITUDE, LONGITUDE = 6_371_000.0, 36.59, -84.41375  # of the sphere [m]; true to scale; x = 0 [degrees]
CRS = f"+proj=eqc +lat_ts={LATITUDE} +lon_0={LONGITUDE} +R={RADIUS:.0f} +units=m +no_defs"
CORNER, SIZE = (15_900.0, 4_057_300.0), (3600.0, 2600.0)  # of the part that is taken, x and y [m]
CENTRE, RELEASE = (16_480.0, 4_058_230.0), (170.0, 230.0)  # of an ellipse, and its half axes [m]
THICKNESS = 25.0  # m

SCENE = {
    "name": "landslide",
    "gravity": [0.0, 0.0, -9.81],
    "duration": 60.0,
    "materials": {
        "debris": {
            "density": 2000.0,
            "youngs_modulus": 2.0e7,
            "poisson_ratio": 0.3,
            "friction_angle_deg": 32.0,
        }
    },
    "terrain": {"file": "elevation.asc", "crs": CRS, "wall": {"condition": "friction", "friction": 0.3}},
    "bodies": [{"outline": "release.geojson", "thickness": THICKNESS, "material": "debris"}],
    "walls": {face: {"condition": "slip"} for face in ("x-", "x+", "y-", "y+", "z-", "z+")},
}


def elevation(cell: float) -> Raster:
    """Return the ground on square cells, by bilinear interpolation between the model's points."""
    from matplotlib.cbook import get_sample_data
    from scipy.ndimage import map_coordinates

    model = get_sample_data("jacksboro_fault_dem.npz")
    x, y = (low + np.arange(cell / 2, length, cell) for low, length in zip(CORNER, SIZE, strict=True))
    longitude = LONGITUDE + np.degrees(x / (RADIUS * math.cos(math.radians(LATITUDE))))
    latitude = np.degrees(y / RADIUS)
    row = (float(model["ymin"]) - latitude) / float(model["dy"])  # the first row is the northernmost, and "ymin"
    column = (longitude - float(model["xmin"])) / float(model["dx"])
    places = np.meshgrid(row, column)
    heights = map_coordinates(model["elevation"].astype(np.float64), places, order=1)
    return Raster(heights, (float(x[0]), float(y[0])), cell, CRS)


def write_scene(folder: Path, cell: float) -> Path:
    """Write the three files into a folder, with cells of the ground of so many metres, and return the scene's."""
    folder.mkdir(parents=True, exist_ok=True)
    write_raster(folder / "elevation", elevation(cell))
    angles = np.linspace(0, 2 * np.pi, 33)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) * RELEASE + CENTRE
    ring[-1] = ring[0]
    polygon = {"type": "Polygon", "coordinates": [ring.round(2).tolist()]}
    (folder / "release.geojson").write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": polygon}))
    (folder / "landslide.yaml").write_text(yaml.safe_dump(SCENE, sort_keys=False))
    return folder / "landslide.yaml"


def main() -> None:
    """Write the three files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cell", type=float, default=25.0, help="edge of a cell of the ground [m]")
    arguments = parser.parse_args()
    path = write_scene(arguments.folder, arguments.cell)
    print(f"{path}: {np.pi * np.prod(RELEASE) * THICKNESS:.3g} m³ on {SIZE[0]:g} × {SIZE[1]:g} m")


if __name__ == "__main__":
    main()
