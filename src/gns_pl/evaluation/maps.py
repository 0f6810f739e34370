"""Maps of a run in files: rasters that a geographic information system opens, outlines, and figures."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError, tolerated
from gns_pl.evaluation.checks import check_figures, make_folder
from gns_pl.fields import ParticleType
from gns_pl.io import open_trajectory, read_header, read_trajectory, read_window
from gns_pl.io.geojson import write_outlines
from gns_pl.io.raster import read_crs, scene_crs, write_raster
from gns_pl.metrics.curves import mobile
from gns_pl.metrics.outlines import area_of, polygons_above
from gns_pl.metrics.rasters import FlowMaps, MapGrid, check_mappable, compute_maps
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory

CAPTIONS = {
    "map": "The deposit on the map",
    "maps": "Deposit, largest thickness, time of arrival, and largest velocity",
}
"""Ending of a figure's name → what it shows."""


def check_maps(*, figures: bool, reached: float | None, key: str) -> None:
    """Refuse what no map can be made of, before anything is run.

    Args:
        figures: are wanted.
        reached: thickness from which on a cell counts as reached [m]; None for the usual one.
        key: of these settings on the command line, for messages.

    Raises:
        InputError: a package that is missing, or a thickness that is none.
    """
    if reached is not None and not reached > 0:
        raise InputError(f"{key}.reached must be a thickness above 0 m, or null, not {reached}.")
    if find_spec("contourpy") is None:
        raise InputError("outlines on maps need contourpy, which comes with matplotlib: pip install 'gns_pl[viz]'.")
    if figures:
        check_figures(without=f", or go without: {key}.figures=false")


def check_mapped_scene(scene: Scene) -> None:
    """Raise an `InputError` where a scene has no map, or names a coordinate reference system that is none."""
    check_mappable(scene)
    read_crs(scene_crs(scene))


def maps_of(run: Trajectory | Path, grid: MapGrid | None = None, reached: float | None = None) -> FlowMaps:
    """Return the maps of a run, of one in a file frame by frame; other arguments as those of `compute_maps`."""
    if isinstance(run, Trajectory):
        return compute_maps(mobile(run), None, grid, reached)
    start = read_trajectory(run, 1)
    keep = start.particle_type != ParticleType.KINEMATIC

    def frames() -> Iterator[NDArray[np.floating]]:
        number = read_header(run).num_frames
        with open_trajectory(run) as file:
            for frame in range(number):
                yield read_window(file, frame, 1)[0, keep]

    return compute_maps(mobile(start), frames(), grid, reached)


def write_maps(
    maps: FlowMaps, scene: Scene, folder: Path, *, name: str, title: str = "", figures: bool = True
) -> list[Path]:
    """Write rasters, outlines and figures of a run into a folder and return the files.

    Args:
        maps: of the run.
        scene: that was run; its origin is added, and its ground is shown.
        folder: made.
        name: how the files begin.
        title: of the figures.
        figures: draw them; they cost no raster where they cannot be drawn.

    Raises:
        InputError: a folder that cannot be written, or a reference system that is none.
        StorageError: the disk refuses.
    """
    make_folder(folder)
    origin, crs = scene.origin[:2], scene_crs(scene)
    files = []
    for quantity, values in maps.rasters().items():
        files += write_raster(folder / f"{name}_{quantity}", maps.grid.raster(values, origin, crs))
    outlines = []
    for outline, values in (("release", maps.release), ("runout", maps.max_thickness), ("deposit", maps.deposit)):
        polygons = polygons_above(values, maps.grid, maps.reached)
        facts = {"outline": outline, "thickness_m": maps.reached, "area_m2": area_of(polygons)}
        outlines.append((facts, [[ring + np.array(origin) for ring in polygon] for polygon in polygons]))
    files.append(write_outlines(folder / f"{name}_outlines.geojson", outlines, crs))
    if figures:
        with tolerated("the map figures"):
            files += _draw(maps, scene, folder, name, title)
    return files


def _draw(maps: FlowMaps, scene: Scene, folder: Path, name: str, title: str) -> list[Path]:
    from gns_pl.viz.ground import ground_height
    from gns_pl.viz.maps import layers, lines, plot_map

    shown, (x, y) = list(layers(maps).values()), scene.origin[:2]
    ground = ground_height(scene, maps.grid) + scene.origin[2]
    files = [folder / f"{name}_{ending}.png" for ending in CAPTIONS]
    for path, some in zip(files, (shown[:1], shown), strict=True):
        plot_map(some, lines(maps), maps.grid, ground, [path], origin=(x, y), title=title)
    return files


def map_rows(maps: FlowMaps, scene: Scene) -> list[tuple[str, str]]:
    """Return label and text of what is printed about the maps of a run."""
    reached = maps.max_thickness >= maps.reached
    velocity = "none, since these particles show a layer and not its motion, and the run does not say it"
    if maps.max_velocity is not None:
        velocity = f"{maps.max_velocity.max():.3g} m/s"
    late = float(np.nanmax(maps.arrival_time)) if reached.any() else 0.0
    rows = [
        (
            "maps",
            f"{maps.grid.shape[0]} × {maps.grid.shape[1]} cells of {maps.grid.cell:.3g} m, reached where the thickness "
            f"is {maps.reached:.3g} m or more: {maps.area():.4g} m², the last at {late:.3g} s",
        ),
        (
            "largest",
            f"thickness {maps.max_thickness.max():.3g} m, thickness of the deposit "
            f"{maps.deposit.max():.3g} m, velocity {velocity}",
        ),
    ]
    if scene.terrain is not None and touches_edge(maps, scene):
        rows.append(("edge", "the flow reached the edge of the box, whose walls kept it in; give it a larger box"))
    return rows


def touches_edge(maps: FlowMaps, scene: Scene) -> bool:
    """Return whether a cell at the edge of the box was reached that was not part of the release."""
    flooded = (maps.max_thickness >= maps.reached) & (maps.release < maps.reached)
    edges = []
    for axis, (low, high) in enumerate(zip(scene.lower[:2], scene.upper[:2], strict=True)):
        middle = maps.grid.centres[axis]
        at_edge = (middle < low + maps.grid.cell) | (middle > high - maps.grid.cell)
        edges.append(flooded.any(axis=1 - axis) & at_edge)
    return bool(edges[0].any() or edges[1].any())
