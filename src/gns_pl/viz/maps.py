"""Maps: rasters of a run in colour over the shaded ground with its contours, and outlines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.metrics.measures import Floats
from gns_pl.metrics.outlines import polygons_above
from gns_pl.metrics.rasters import FlowMaps, MapGrid
from gns_pl.viz.plots import STYLE, LineStyle

RELEASE, RUNOUT = "#0072B2", "#000000"
"""Colours of the outlines."""

PAGE = 6.6
"""Width of a figure [inch]."""

CONTOURS = 18
"""About so many contours of the ground."""

CLASSES = 6
"""At most so many colours of a raster."""

STEPS = (1, 2, 5, 10)

MARGIN = 0.25
"""Of the longer side of what is shown, around it."""


@dataclass(frozen=True)
class Layer:
    """A raster as a map shows it.

    Attributes:
        values: [X, Y], NaN where the ground shows.
        label: above the panel, with the unit.
        colours: name of matplotlib's colour map.
        limits: ends of the scale; None for those of the values.
    """

    values: Floats
    label: str
    colours: str = "YlOrRd"
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Line:
    """An outline: where a raster [X, Y] reaches a level.

    Attributes:
        values: [X, Y].
        level: of the line.
        label: in the legend.
        colour: as matplotlib names it.
        style: of the line.
        panel: number of the only panel that has it; None for all.
    """

    values: Floats
    level: float
    label: str
    colour: str
    style: LineStyle = "-"
    panel: int | None = None


def layers(maps: FlowMaps) -> dict[str, Layer]:
    """Return name → layer of the rasters of a run, the deposit first; thinner than `reached` the ground shows."""
    shown = maps.max_thickness >= maps.reached

    def where(values: Floats, reached: Any) -> Floats:
        return np.where(reached, values, np.nan)

    found = {
        "deposit": Layer(where(maps.deposit, maps.deposit >= maps.reached), "Thickness of the deposit [m]"),
        "max_thickness": Layer(where(maps.max_thickness, shown), "Largest thickness [m]"),
        "arrival_time": Layer(maps.arrival_time, "Time of arrival [s]", "viridis_r"),
    }
    if maps.max_velocity is not None:
        found["max_velocity"] = Layer(where(maps.max_velocity, shown), "Largest velocity [m/s]", "PuRd")
    return found


def lines(maps: FlowMaps) -> list[Line]:
    """Return the outlines of a run."""
    text = f"{maps.reached:.2g} m"
    return [
        Line(maps.max_thickness, maps.reached, f"runout ({text} reached at some time)", RUNOUT),
        Line(maps.release, maps.reached, f"release ({text} at the start)", RELEASE, "--"),
    ]


def plot_map(
    shown: Sequence[Layer],
    outlines: Sequence[Line],
    grid: MapGrid,
    ground: Floats,
    paths: Sequence[Path],
    *,
    origin: tuple[float, float] = (0.0, 0.0),
    title: str = "",
) -> None:
    """Draw rasters over the shaded ground, side by side, around what they cover.

    Args:
        shown: one panel each.
        outlines: in every panel, or in their own.
        grid: the cells.
        ground: height of the ground in the middle of every cell [X, Y] [m].
        paths: files to write; the ending says the format.
        origin: where the scene's zero lies in the coordinates of the map [m].
        title: above all.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    covered = np.any([line.values >= line.level for line in outlines], axis=0)
    covered |= np.any([np.isfinite(layer.values) for layer in shown], axis=0)
    part = _around(covered)
    x, y = (zero + low for zero, low in zip(origin, grid.lower, strict=True))
    grid = MapGrid((x, y), grid.cell, grid.shape)
    width, height = (each.stop - each.start for each in part)
    seen = MapGrid((x + grid.cell * part[0].start, y + grid.cell * part[1].start), grid.cell, (width, height))
    ratio = height / width
    columns = 1 if len(shown) == 1 or ratio < 0.4 else 2
    rows = math.ceil(len(shown) / columns)
    panel = PAGE / columns
    with mpl.rc_context(STYLE):
        named = {line.label: mpl.lines.Line2D([], [], color=line.colour, linestyle=line.style) for line in outlines}
        legend = 0.6 + 0.2 * math.ceil(len(named) / 3)  # with the axis above it [inches]
        height_of_all = min(rows * ((panel - 1.2) * ratio + 0.45) + legend, 12.0)
        figure = Figure(figsize=(PAGE, height_of_all), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for number, (axes, layer) in enumerate(zip(panels, shown, strict=False)):
            draw_ground(axes, seen, ground[part])
            draw_layer(axes, seen, layer, layer.values[part])
            for line in (each for each in outlines if each.panel in (None, number)):
                for ring in (ring for polygon in polygons_above(line.values, grid, line.level) for ring in polygon):
                    axes.plot(*ring.T, color=line.colour, linestyle=line.style, linewidth=1.1)
            left, right, bottom, top = _extent(seen)
            axes.set(xlim=(left, right), ylim=(bottom, top))
        for axes in panels[len(shown) :]:
            axes.remove()
        for axes in panels[max(0, len(shown) - columns) : len(shown)]:  # also above one that was removed
            axes.xaxis.set_tick_params(labelbottom=True)
            axes.set_xlabel("x [m]")
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=min(3, len(named)))
        if title:
            figure.suptitle(title, fontsize=9)
        for path in paths:
            figure.savefig(path)


def _around(covered: Any) -> tuple[slice, slice]:
    """Return the part of a grid that holds what is covered, with a margin around it; all where nothing is."""
    ends = [np.flatnonzero(covered.any(axis=1 - axis)) for axis in (0, 1)]
    if not len(ends[0]):
        return slice(0, covered.shape[0]), slice(0, covered.shape[1])
    margin = max(2, math.ceil(MARGIN * max(end[-1] - end[0] for end in ends)))
    first, second = (
        slice(max(0, int(end[0]) - margin), min(number, int(end[-1]) + margin + 1))
        for end, number in zip(ends, covered.shape, strict=True)
    )
    return first, second


def draw_ground(axes: Any, grid: MapGrid, ground: Floats) -> None:
    """Draw the ground shaded from the north-west, with contours at round heights."""
    from matplotlib.colors import LightSource

    # The rows of an image run from north to south, and so does LightSource's second axis.
    rows = ground.T[::-1]
    light = LightSource(azdeg=315, altdeg=45)
    shade = light.hillshade(rows, dx=grid.cell, dy=grid.cell) if min(rows.shape) > 1 else np.full(rows.shape, 0.7)
    axes.imshow(shade, cmap="gray", vmin=-0.6, vmax=1.0, extent=_extent(grid), interpolation="bilinear")
    span = float(ground.max() - ground.min())
    if span > 1e-9 and min(ground.shape) > 1:
        power = 10.0 ** math.floor(math.log10(span / CONTOURS))
        step = next(each for each in STEPS if each * power >= 0.999 * span / CONTOURS) * power
        heights = step * np.arange(math.floor(ground.min() / step) + 1, math.ceil(ground.max() / step))
        contours = axes.contour(*grid.centres, ground.T, levels=heights, colors="#5b4636", linewidths=0.35, alpha=0.8)
        axes.clabel(contours, contours.levels[::2], fmt="%g", fontsize=5.5, inline_spacing=2)
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(_ticks(5))
        axis.set_major_formatter(lambda value, _: f"{value:,.10g}".replace(",", "\u202f"))
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _ticks(number: int) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=number, steps=list(STEPS))


def draw_layer(axes: Any, grid: MapGrid, layer: Layer, values: Floats) -> None:
    """Draw a raster in steps of colour between round values, with its colour bar."""
    import matplotlib as mpl

    masked = np.ma.masked_invalid(values.T[::-1])
    low, high = layer.limits or (0.0, float(masked.max()) if masked.count() else 1.0)
    levels = _ticks(CLASSES).tick_values(low, high or 1.0)
    colours = mpl.colormaps[layer.colours]
    norm = mpl.colors.BoundaryNorm(levels, colours.N)
    image = axes.imshow(masked, cmap=colours, norm=norm, alpha=0.85, extent=_extent(grid), interpolation="nearest")
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02, aspect=25, spacing="proportional", ticks=levels)
    bar.outline.set_linewidth(0.4)
    axes.set_title(layer.label, loc="left")
    axes.label_outer()


def _extent(grid: MapGrid) -> tuple[float, float, float, float]:
    (x, y), (width, height) = grid.lower, grid.shape
    return x, x + width * grid.cell, y, y + height * grid.cell
