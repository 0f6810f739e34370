"""Runouts of columns over their aspect ratio, beside published laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from gns_pl.viz.plots import COLOURS, STYLE


def plot_laws(
    runouts: Mapping[str, Sequence[tuple[float, float, float]]],
    laws: Mapping[str, Callable[[float], float]],
    paths: Sequence[Path],
) -> None:
    """Draw final runouts as points, published laws as lines, on logarithmic axes.

    Args:
        runouts: simulator (the reference first) → aspect ratio, runout [L0] and its uncertainty [L0] of every column;
            runouts that are not finite or not positive are left out.
        laws: source → runout [L0] of an aspect ratio.
        paths: files to write; the ending says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    known = [ratio for points in runouts.values() for ratio, _, _ in points]
    ratios = np.geomspace(0.8 * min(known), 1.25 * max(known), 100)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.6, 3.2), layout="constrained")
        axes = figure.subplots()
        for (source, law), style in zip(laws.items(), ("-", "--", "-.", ":"), strict=False):
            axes.plot(
                ratios, [law(ratio) for ratio in ratios], color="0.6", linestyle=style, linewidth=0.9, label=source
            )
        for (name, points), colour, marker in zip(runouts.items(), COLOURS, "osD^", strict=False):
            positive = [point for point in points if np.isfinite(point[1]) and point[1] > 0]
            if not positive:
                continue
            ratio, runout, spread = (np.array(values) for values in zip(*positive, strict=True))
            axes.errorbar(
                ratio, runout, yerr=np.minimum(spread, 0.99 * runout) if spread.any() else None,
                color=colour, marker=marker, markersize=4,
                markerfacecolor="none" if name != next(iter(runouts)) else colour, linestyle="none",
                elinewidth=0.8, capsize=2, label=name,
            )  # fmt: skip
        ticks = [tick for tick in (0.2, 0.3, 0.5, 0.8, 1, 1.2, 2, 3, 4, 6, 10) if ratios[0] <= tick <= ratios[-1]]
        axes.set(xscale="log", yscale="log", xlabel="aspect ratio $H_0/L_0$", ylabel="runout $(L_f - L_0)/L_0$")
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        heights = [tick for tick in (0.2, 0.5, 1, 2, 5, 10) if axes.get_ylim()[0] <= tick <= axes.get_ylim()[1]]
        axes.set_yticks(heights, [f"{tick:g}" for tick in heights])
        axes.legend(loc="best", fontsize=6)
        for path in paths:
            figure.savefig(path)
