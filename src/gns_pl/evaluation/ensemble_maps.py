"""Maps of an ensemble in files: means, shares of the runs, outlines of equal shares, and a figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gns_pl.errors import tolerated
from gns_pl.io.geojson import write_outlines
from gns_pl.io.raster import scene_crs, write_raster
from gns_pl.metrics.exceedance import EnsembleMaps
from gns_pl.metrics.outlines import area_of, polygons_above
from gns_pl.scene import Scene
from gns_pl.viz.plots import LineStyle

SHARES = (0.05, 0.5, 0.95)
"""Shares of the runs whose outlines are drawn and written."""

COLOURS = ("#0072B2", "#000000", "#D55E00")
STYLES: tuple[LineStyle, ...] = (":", "-", "--")

MOST_PANELS = 3
"""Of more thresholds the first are drawn."""


def write_ensemble(maps: EnsembleMaps, scene: Scene, folder: Path, *, figures: bool) -> list[Path]:
    """Write the maps of an ensemble into a folder and return the files.

    Args:
        maps: of the runs.
        scene: from which the members' scenes were made; its name begins the files, its origin is added.
        folder: that is there.
        figures: draw the figure.

    Raises:
        StorageError: the disk refuses.
    """
    (x, y), crs, name = scene.origin[:2], scene_crs(scene), scene.name
    rasters = {f"mean_{quantity}": values for quantity, values in maps.mean.items()}
    rasters |= {f"exceedance_{threshold:.3g}m": share for threshold, share in maps.exceedance.items()}
    files = []
    for quantity, values in rasters.items():
        files += write_raster(folder / f"{name}_{quantity}", maps.grid.raster(values, (x, y), crs))
    outlines = []
    for threshold, share in maps.exceedance.items():
        for level in SHARES:
            polygons = polygons_above(share, maps.grid, level)
            facts = {"thickness_m": threshold, "share_of_runs": level, "area_m2": area_of(polygons)}
            outlines.append((facts, [[ring + np.array([x, y]) for ring in polygon] for polygon in polygons]))
    files.append(write_outlines(folder / f"{name}_exceedance.geojson", outlines, crs))
    if figures:
        with tolerated("the figure of the ensemble"):
            files.append(_draw(maps, scene, folder / f"{name}_ensemble.png"))
    return files


def _draw(maps: EnsembleMaps, scene: Scene, path: Path) -> Path:
    from gns_pl.viz.ground import ground_height
    from gns_pl.viz.maps import Layer, Line, plot_map

    thresholds = list(maps.exceedance)[:MOST_PANELS]
    panels = [
        Layer(
            np.where(maps.exceedance[each] > 0, 100 * maps.exceedance[each], np.nan),
            f"Runs that reach {each:.2g} m [%]",
            "YlOrRd",
            (0.0, 100.0),
        )
        for each in thresholds
    ]
    deposit = maps.mean["deposit"]
    shown = np.where(deposit >= 0.1 * thresholds[0], deposit, np.nan)
    panels.append(Layer(shown, "Mean thickness of the deposit [m]", "YlGnBu"))
    lines = [
        Line(maps.exceedance[threshold], level, f"in {100 * level:g} % of the runs", colour, style, panel)
        for panel, threshold in enumerate(thresholds)
        for level, colour, style in zip(SHARES, COLOURS, STYLES, strict=True)
    ]
    ground = ground_height(scene, maps.grid) + scene.origin[-1]
    title, origin = f"{scene.name}: {maps.num_members} runs", (scene.origin[0], scene.origin[1])
    plot_map(panels, lines, maps.grid, ground, [path], origin=origin, title=title)
    return path
