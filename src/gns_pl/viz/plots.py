"""Figures for print: curves over time, and snapshots of a flow beside its reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gns_pl.trajectory import Trajectory
from gns_pl.viz.raster import View, colour_map, displacement, displacement_limit, draw_grains, side_window

Floats = NDArray[np.float64]

LineStyle = Literal["-", "--", ":"]

COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73")
"""One per simulator, the reference first: Okabe and Ito's palette, told apart by colour-blind eyes and in grey."""

STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "savefig.dpi": 200,
}


STATIC = 0.02
"""What has moved by less than this share of the bodies' height belongs to the static part."""


@dataclass(frozen=True)
class Panel:
    """One kind of axes over time.

    Attributes:
        label: of the vertical axis.
        lines: name of a curve → what a legend says of it and its line style.
        normalise: divide by the reference's initial value of this curve; "" does not.
    """

    label: str
    lines: Mapping[str, tuple[str, LineStyle]]
    normalise: str = ""


PANELS = {
    "runout": Panel("runout $(L_t - L_0)/L_0$", {"runout_99": ("99 % of mass", "-"), "runout_max": ("maximum", ":")}),
    "height": Panel("height $H_t/L_0$", {"height_99": ("99 % of mass", "-"), "height_max": ("maximum", ":")}),
    "energy": Panel(
        "energy / initial potential energy",
        {
            "potential_energy": ("potential", "-"),
            "kinetic_energy": ("kinetic", "--"),
            "dissipated_energy": ("lost", ":"),
        },
        "potential_energy",
    ),
    "speed": Panel("speed [m/s]", {"speed_mean": ("mean", "-"), "speed_99": ("99 % of particles", ":")}),
}


def plot_curves(
    curves: Mapping[str, Mapping[str, Mapping[str, Floats]]],
    panels: Sequence[str],
    paths: Sequence[Path],
    bands: Mapping[str, Mapping[str, Mapping[str, tuple[Floats, Floats]]]] | None = None,
) -> None:
    """Draw one row of panels per scene, every simulator in its colour, over t/τc.

    Args:
        curves: scene → simulator (the reference first) → name → [T]; "time_tau" is the horizontal axis.
        panels: names in `PANELS`, one column each.
        paths: files to write; the ending says the format.
        bands: scene → simulator → name of a curve → its lowest and highest values [T], shaded behind the curve; only
            a panel's main curve, its first, has one.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    with mpl.rc_context(STYLE):
        size = (3.4 * len(panels), 2.3 * len(curves) + 0.35)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(len(curves), len(panels), squeeze=False, sharex="row")
        for row, (scene, simulators) in zip(grid, curves.items(), strict=True):
            for axes, name in zip(row, panels, strict=True):
                _draw_panel(axes, PANELS[name], simulators, (bands or {}).get(scene, {}))
            row[0].set_title(scene, loc="left", fontweight="bold")
            for axes in row:
                axes.set_xlabel("time $t/\\tau_c$")
        for axes, name in zip(grid[0], panels, strict=True):
            handles = [Line2D([], [], color="0.4", linestyle=style) for _, style in PANELS[name].lines.values()]
            axes.legend(handles, [label for label, _ in PANELS[name].lines.values()], loc="best")
        known = list(dict.fromkeys(name for simulators in curves.values() for name in simulators))
        handles = [Line2D([], [], color=COLOURS[index % len(COLOURS)]) for index in range(len(known))]
        figure.legend(handles, known, loc="outside upper center", ncols=len(known))
        for path in paths:
            figure.savefig(path)


def _draw_panel(
    axes: Any,
    panel: Panel,
    simulators: Mapping[str, Mapping[str, Floats]],
    bands: Mapping[str, Mapping[str, tuple[Floats, Floats]]],
) -> None:
    reference = next(iter(simulators.values()))
    scale = abs(float(reference[panel.normalise][0])) or 1.0 if panel.normalise else 1.0
    for index, (simulator, curves) in enumerate(simulators.items()):
        band = bands.get(simulator, {}).get(next(iter(panel.lines)))
        if band is not None:
            low, high = (edge / scale for edge in band)
            axes.fill_between(
                curves["time_tau"], low, high, color=COLOURS[index % len(COLOURS)], alpha=0.2, linewidth=0
            )
        for order, (name, (_, style)) in enumerate(panel.lines.items()):
            axes.plot(
                curves["time_tau"],
                curves[name] / scale,
                color=COLOURS[index % len(COLOURS)],
                linestyle=style,
                linewidth=0.9 if order else 1.4,
            )
    axes.set_ylabel(panel.label)
    axes.set_xlim(0, float(reference["time_tau"][-1]) or None)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def plot_evolution(
    trajectories: Mapping[str, Trajectory],
    paths: Sequence[Path],
    *,
    time_scale: float,
    times: Sequence[float],
    diameter: float,
    pixels: int = 900,
) -> None:
    """Draw snapshots from the side, one column per simulator and one row per time, coloured by displacement.

    A line is the failure surface: below it lies what has moved by less than `STATIC` of the body's height so far.

    Args:
        trajectories: title → trajectory of one scene; the last one is the reference, which sets the colour scale and
            the last time. One that ends before a row's time leaves its place empty and says so.
        paths: files to write; the ending says the format. Particles are an image in all of them.
        time_scale: τc [s].
        times: of the rows [τc], those beyond the end left out; the end comes besides.
        diameter: of a grain [m].
        pixels: width of a panel's image.
    """
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    reference = list(trajectories.values())[-1]
    end = (reference.num_frames - 1) * reference.dt
    rows = [time * time_scale for time in times if time * time_scale < end * (1 - 1e-9)] + [end]
    lower, upper = side_window(list(trajectories.values()), diameter)
    view = View(lower, upper, pixels / (upper[0] - lower[0]))
    colours = ScalarMappable(Normalize(0, displacement_limit(reference)), colour_map())
    with mpl.rc_context(STYLE):
        panel_height = 3.3 * view.shape[0] / view.shape[1]
        figure = Figure(figsize=(3.5 * len(trajectories) + 0.5, (panel_height + 0.28) * len(rows) + 0.55))
        figure.set_layout_engine("constrained", h_pad=0.02, hspace=0.02)
        grid = figure.subplots(len(rows), len(trajectories), squeeze=False, sharex=True, sharey=True)
        for line, time in zip(grid, rows, strict=True):
            for axes, (title, trajectory) in zip(line, trajectories.items(), strict=True):
                _draw_snapshot(axes, trajectory, time, view, diameter, colours)
                axes.set_title(f"{title}, $t/\\tau_c$ = {time / time_scale:.3g}", loc="left", pad=3)
            line[0].set_ylabel("z [m]")
        for axes in grid[-1]:
            axes.set_xlabel("x [m]")
        figure.colorbar(colours, ax=grid, label="displacement [m]", extend="max", shrink=0.6, aspect=30)
        for path in paths:
            figure.savefig(path)


def _draw_snapshot(axes: Any, trajectory: Trajectory, time: float, view: View, diameter: float, colours: Any) -> None:
    frame = round(time / trajectory.dt)
    scene = trajectory.scene
    axes.set(xlim=(view.lower[0], view.upper[0]), ylim=(view.lower[1], view.upper[1]), aspect="equal")
    for body in scene.bodies:
        x, z = body.position[0], body.position[-1]
        outline = [(x, z), (x, z + body.size[-1]), (x + body.size[0], z + body.size[-1]), (x + body.size[0], z)]
        axes.plot(*zip(*outline, strict=True), color="0.55", linewidth=0.7, linestyle=(0, (4, 3)))
    if frame >= trajectory.num_frames:
        axes.text(0.5, 0.5, "not finite any more", ha="center", va="center", transform=axes.transAxes, color="0.4")
        return
    values, shades = draw_grains(trajectory.position[frame], displacement(trajectory, frame), view, diameter)
    image = np.asarray(colours.to_rgba(np.nan_to_num(values)))
    image[..., :3] *= np.nan_to_num(shades)[..., None]
    image[..., 3] = np.isfinite(values)
    axes.imshow(image, extent=(view.lower[0], view.upper[0], view.lower[1], view.upper[1]), zorder=3)
    if frame:
        along, surface = failure_surface(trajectory, frame, diameter)
        axes.plot(along, surface, color="white", linewidth=2.2, zorder=4, drawstyle="steps-mid")
        axes.plot(along, surface, color="black", linewidth=1.0, zorder=5, drawstyle="steps-mid")


def failure_surface(trajectory: Trajectory, frame: int, diameter: float) -> tuple[Floats, Floats]:
    """Return how high the static part reaches in bins along x [m].

    Args:
        trajectory: of one scene.
        frame: at which a particle is static that has moved by less than `STATIC` of the bodies' height.
        diameter: of a grain [m]; bins are two of them wide.

    Returns:
        Middles of the bins and the surface's z there, both [B]; NaN where nothing is static.
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
    return scene.lower[0] + (np.arange(number) + 0.5) * length / number, surface
