"""Survival of runs along the axes of the stress suite."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gns_pl.viz.plots import COLOURS, STYLE

Steps = tuple[NDArray[np.float64], NDArray[np.float64]]


def plot_survival(curves: Mapping[str, Mapping[str, Steps]], paths: Sequence[Path]) -> None:
    """Draw a panel for every axis, with a step curve for every model.

    Args:
        curves: model → axis → times [τc] and share of runs without a failure from each on.
        paths: files to write; the ending says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(axis for of_axes in curves.values() for axis in of_axes))
    columns = min(4, len(names))
    rows = math.ceil(len(names) / columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.0 * columns, 1.45 * rows + 0.5), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for panel, axis in zip(panels.flat, names, strict=False):
            for place, (model, of_axes) in enumerate(curves.items()):
                if axis not in of_axes:
                    continue
                times, shares = of_axes[axis]
                style = ("-", "--", "-.", ":")[place // len(COLOURS) % 4]
                lift = 0.012 * place  # so that curves of one share are all seen
                panel.step(
                    times, shares + lift, where="post", label=model, color=COLOURS[place % len(COLOURS)],
                    linestyle=style, linewidth=1.2,
                )  # fmt: skip
            panel.set(title=axis.replace("_", " "), ylim=(-0.03, 1.03 + 0.012 * len(curves)), xlim=(0, None))
        for panel in list(panels.flat)[len(names) :]:
            panel.set_visible(False)
        for panel in panels[:, 0]:
            panel.set_ylabel("without a failure")
        for panel in panels[-1]:
            panel.set_xlabel(r"$t / \tau_c$")
        shown = {line.get_label(): line for panel in panels.flat for line in panel.lines}  # not all ran on every axis
        lines = [shown[model] for model in curves if model in shown]
        figure.legend(handles=lines, loc="outside lower center", ncols=min(4, len(lines)), fontsize=7)
        for path in paths:
            figure.savefig(path)
