"""Outlines as GeoJSON (RFC 7946), in the coordinates of the map.

The standard knows longitude and latitude alone. The member `crs` of its first edition (2008) says which other
coordinates these are; geographic information systems read it still.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.io.atomic import write_atomically

Polygon = Sequence[NDArray[np.float64]]
"""Closed rings [P, 2] [m]: the outer one anticlockwise, then the holes clockwise."""


def write_outlines(path: Path, outlines: Sequence[tuple[Mapping[str, Any], Sequence[Polygon]]], crs: str = "") -> Path:
    """Write features, each with its properties and polygons.

    Args:
        path: the file.
        outlines: properties and polygons of every feature.
        crs: coordinate reference system, as "EPSG:32617"; one without a number of EPSG is left out.

    Raises:
        StorageError: the disk refuses.
    """
    collection: dict[str, Any] = {"type": "FeatureCollection"}
    number = re.fullmatch(r"EPSG:(\d+)", crs.strip(), re.IGNORECASE)
    if number:
        collection["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{number[1]}"}}
    collection["features"] = [
        {
            "type": "Feature",
            "properties": dict(properties),
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [[ring.tolist() for ring in each] for each in polygons],
            },
        }
        for properties, polygons in outlines
    ]
    write_atomically(path, json.dumps(collection, allow_nan=False).encode())
    return path
