"""Figures for print: snapshots of a flow beside its reference, from the side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.scene import Scene
from gns_pl.scene.boundaries import signed_distance
from gns_pl.trajectory import Trajectory
from gns_pl.viz.colouring import Colouring
from gns_pl.viz.plots import STYLE
from gns_pl.viz.raster import View, displacement, draw_grains, obstacle_outlines, side_window

Floats = NDArray[np.float64]

STATIC = 0.02
"""What has moved by less than this share of the bodies' height belongs to the static part."""

LEAST_GAP = 0.05
"""A snapshot nearer to the next one than this share of the run shows nothing new and is left out."""

WIDTH, HEIGHT, FIGURE_HEIGHT = 3.5, 2.6, 9.0
"""Largest width and height of a panel, and about that of all rows together [inches]."""

GRAIN_PIXELS = 12
"""Of a grain's diameter, so that it looks round in a narrow panel too."""

OBSTACLE = "0.8"
"""Grey of obstacles."""


def plot_evolution(
    trajectories: Mapping[str, Trajectory],
    paths: Sequence[Path],
    *,
    time_scale: float,
    times: Sequence[float],
    diameter: float,
    pixels: int = 900,
) -> None:
    """Draw snapshots from the side, one column per simulator and one row per time.

    Grains are coloured by displacement, or by material where the scene has several; obstacles are grey. Where bodies
    stand on the floor a line is the failure surface: below it lies what has moved by less than `STATIC` of the body's
    height so far.

    Args:
        trajectories: title → trajectory of one scene; the last one is the reference, which sets the colour scale and
            the last time. One that ends before a row's time leaves its place empty and says so.
        paths: files to write; the ending says the format. Particles are an image in all of them.
        time_scale: τc [s].
        times: of the rows [τc], as `snapshot_times` chooses from them; the end comes besides.
        diameter: of a grain [m].
        pixels: width of the image of a panel of the largest width.
    """
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    reference = list(trajectories.values())[-1]
    rows = snapshot_times([time * time_scale for time in times], (reference.num_frames - 1) * reference.dt)
    lower, upper = side_window(list(trajectories.values()), diameter)
    size = np.subtract(upper, lower)
    width, height = size * min(WIDTH / size[0], min(HEIGHT, FIGURE_HEIGHT / len(rows)) / size[1])
    fine = max(pixels / WIDTH * width / size[0], GRAIN_PIXELS / diameter)
    view = View(lower, upper, min(fine, 2 * pixels / max(size)))
    colouring = Colouring.of(reference)
    colours = ScalarMappable(Normalize(0, 1), colouring.colour_map())
    with mpl.rc_context(STYLE):
        # Beside a narrow panel there is room for its title.
        figure = Figure(figsize=(max(width, 1.9) * len(trajectories) + 0.6, (height + 0.28) * len(rows) + 0.75))
        figure.set_layout_engine("constrained", h_pad=0.02, hspace=0.02)
        grid = figure.subplots(len(rows), len(trajectories), squeeze=False, sharex=True, sharey=True)
        for line, time in zip(grid, rows, strict=True):
            for axes, (title, trajectory) in zip(line, trajectories.items(), strict=True):
                _draw_snapshot(axes, trajectory, time, view, diameter, colouring, colours)
                axes.set_title(f"{title}, $t/\\tau_c$ = {time / time_scale:.3g}", loc="left", pad=3)
            line[0].set_ylabel("z [m]")
        for axes in grid[-1]:
            axes.set_xlabel("x [m]")
        if colouring.names:
            patches = [Patch(color=colour, label=name) for name, colour in colouring.legend()]
            figure.legend(handles=patches, loc="outside lower center", ncols=len(patches))
        else:
            scale = ScalarMappable(Normalize(0, colouring.limit), colours.cmap)
            figure.colorbar(scale, ax=grid, label="displacement [m]", extend="max", shrink=0.6, aspect=30)
        for path in paths:
            figure.savefig(path)


def snapshot_times(times: Sequence[float], end: float) -> list[float]:
    """Return the times that are worth a row, rising, the end last; near-duplicates are left out, those after it too.

    Args:
        times: wanted [s].
        end: of the run [s].
    """
    moments: list[float] = []
    for time in sorted(times):
        if 0 <= time < end and time <= (1 - LEAST_GAP) * end and (not moments or time - moments[-1] >= LEAST_GAP * end):
            moments.append(time)
    return [*moments, end]


def _draw_snapshot(
    axes: Any,
    trajectory: Trajectory,
    time: float,
    view: View,
    diameter: float,
    colouring: Colouring,
    colours: Any,
) -> None:
    frame = round(time / trajectory.dt)
    scene = trajectory.scene
    axes.set(xlim=(view.lower[0], view.upper[0]), ylim=(view.lower[1], view.upper[1]), aspect="equal")
    for outline in obstacle_outlines(scene, view.lower, view.upper):
        axes.fill(*outline.T, facecolor=OBSTACLE, edgecolor="0.4", linewidth=0.6, zorder=1)
    for body in scene.bodies:
        (x0, z0), (x1, z1) = ((corner[0], corner[-1]) for corner in (body.position, body.upper))
        axes.plot([x0, x0, x1, x1], [z0, z1, z1, z0], color="0.55", linewidth=0.7, linestyle=(0, (4, 3)))
    if frame >= trajectory.num_frames:
        axes.text(0.5, 0.5, "not finite any more", ha="center", va="center", transform=axes.transAxes, color="0.4")
        return
    values, shades = draw_grains(trajectory.position[frame], colouring.shares(trajectory, frame), view, diameter)
    image = np.asarray(colours.to_rgba(np.nan_to_num(values)))
    image[..., :3] *= np.nan_to_num(shades)[..., None]
    image[..., 3] = np.isfinite(values)
    axes.imshow(image, extent=(view.lower[0], view.upper[0], view.lower[1], view.upper[1]), zorder=3)
    if frame and stands_on_floor(scene, diameter):
        along, surface = failure_surface(trajectory, frame, diameter)
        axes.plot(along, surface, color="white", linewidth=2.2, zorder=4, drawstyle="steps-mid")
        axes.plot(along, surface, color="black", linewidth=1.0, zorder=5, drawstyle="steps-mid")


def stands_on_floor(scene: Scene, diameter: float) -> bool:
    """Return whether a body stands on the floor of the box and gravity holds it there; else no surface can fail."""
    lowest = min(body.position[-1] for body in scene.bodies) - scene.lower[-1]
    return scene.gravity[-1] < 0 and lowest < 0.5 * diameter


def failure_surface(trajectory: Trajectory, frame: int, diameter: float) -> tuple[Floats, Floats]:
    """Return how high the static part reaches in bins along x [m].

    Args:
        trajectory: of one scene.
        frame: at which a particle is static that has moved by less than `STATIC` of the bodies' height.
        diameter: of a grain [m]; bins are two of them wide.

    Returns:
        Middles of the bins and the surface's z there, both [B]; NaN where nothing is static, or an obstacle stands.
    """
    scene = trajectory.scene
    bodies_height = max(body.upper[-1] for body in scene.bodies) - min(body.position[-1] for body in scene.bodies)
    still = displacement(trajectory, frame) < STATIC * bodies_height
    width, length = 2 * diameter, scene.upper[0] - scene.lower[0]
    number = max(1, round(length / width))
    x, z = trajectory.position[frame].astype(np.float64)[:, [0, -1]].T
    index = np.clip((x - scene.lower[0]) / length * number, 0, number - 1).astype(np.int64)
    surface = np.full(number, np.nan)
    for bin_number in np.unique(index[still]):
        inside = index == bin_number
        moving: Floats = z[inside & ~still]
        # Where both overlap, as grains of several depths do, in the middle.
        top = float(np.percentile(z[inside & still], 95)) + diameter / 2
        lowest = float(np.percentile(moving, 5)) - diameter / 2 if len(moving) else top
        surface[bin_number] = max(scene.lower[-1], (top + lowest) / 2 if lowest < top else top)
    along = scene.lower[0] + (np.arange(number) + 0.5) * length / number
    floor = np.tile((np.array(scene.lower) + scene.upper) / 2, (number, 1))
    floor[:, 0], floor[:, -1] = along, scene.lower[-1] + 0.5 * diameter
    for obstacle in scene.obstacles:
        surface[signed_distance(obstacle, floor)[0] < 0] = np.nan
    return along, surface
