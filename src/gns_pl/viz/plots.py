"""Figures for print: curves over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

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

MOST_SCENES = 8
"""Of more scenes than these the first are drawn; what is longer can neither be printed nor looked at."""


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
    """Draw one row of panels per scene, of `MOST_SCENES` at most, every simulator in its colour, over t/τc.

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

    shown, number = dict(list(curves.items())[:MOST_SCENES]), len(curves)
    with mpl.rc_context(STYLE):
        size = (3.4 * len(panels), 2.3 * len(shown) + 0.35)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(len(shown), len(panels), squeeze=False, sharex="row")
        for row, (scene, simulators) in zip(grid, shown.items(), strict=True):
            for axes, name in zip(row, panels, strict=True):
                _draw_panel(axes, PANELS[name], simulators, (bands or {}).get(scene, {}))
            row[0].set_title(scene, loc="left", fontweight="bold")
            for axes in row:
                axes.set_xlabel("time $t/\\tau_c$")
        for axes, name in zip(grid[0], panels, strict=True):
            handles = [Line2D([], [], color="0.4", linestyle=style) for _, style in PANELS[name].lines.values()]
            axes.legend(handles, [label for label, _ in PANELS[name].lines.values()], loc="best")
        known = list(dict.fromkeys(name for simulators in shown.values() for name in simulators))
        handles = [Line2D([], [], color=COLOURS[index % len(COLOURS)]) for index in range(len(known))]
        figure.legend(handles, known, loc="outside upper center", ncols=len(known))
        if number > len(shown):
            figure.supxlabel(f"the first {len(shown)} of {number} scenes", fontsize=8)
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
