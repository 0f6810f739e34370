"""The learning curve of a training: loss and rollout errors over steps and over hours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.viz.plots import COLOURS, STYLE

Floats = NDArray[np.float64]

RELATIVE = {"runout_99_error": "final runout, 99 % of mass", "mean_height_error": "final mean height"}
"""Errors drawn as signed per cent, and what a legend says of them."""

NUM_POINTS = 60
"""The loss is averaged over about this many pieces of the training."""

LEAST_HOURS = 0.5
"""A shorter training is drawn over minutes."""


def plot_learning_curve(
    training: Mapping[str, Floats], validation: Mapping[str, Floats], path: Path, *, title: str
) -> None:
    """Draw loss, position error and relative errors, over steps and, where they are known, over hours.

    Args:
        training: "step", "hours" and "loss" [rows].
        validation: "step", "hours", "position_error" and the keys of `RELATIVE` [validations]; each may be missing.
        path: file to write.
        title: over the figure.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    places = [("step", 1.0, "training steps")]
    if np.isfinite(training["hours"]).any():
        short = np.nanmax(training["hours"]) < LEAST_HOURS
        places.append(("hours", 60.0, "minutes of training") if short else ("hours", 1.0, "hours of training"))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.5 * len(places), 6.2), layout="constrained")
        grid = figure.subplots(3, len(places), squeeze=False, sharex="col", sharey="row")
        for column, (name, factor, label) in zip(grid.T, places, strict=True):
            _draw_loss(column[0], factor * training[name], training["loss"])
            if len(validation["step"]):
                _draw_position_error(column[1], factor * validation[name], validation)
                _draw_relative(column[2], factor * validation[name], validation)
            column[2].set_xlabel(label)
            column[2].set_xlim(left=0)
            column[2].locator_params(axis="x", nbins=5)  # five figures of a long training have room
        grid[0, 0].set_ylabel("training loss")
        grid[1, 0].set_ylabel("rollout position error [spacings]")
        grid[2, 0].set_ylabel("rollout error [%]")
        if grid[2, 0].get_legend_handles_labels()[0]:
            grid[2, 0].legend(loc="best")
        figure.suptitle(title, fontsize=9)
        figure.savefig(path)


def _draw_loss(axes: Any, where: Floats, loss: Floats) -> None:
    axes.plot(where, loss, color="0.8", linewidth=0.5)
    width = max(1, len(loss) // NUM_POINTS)
    pieces = len(loss) // width * width
    if pieces:  # what is left over at the end is in the grey line
        place, mean = (values[:pieces].reshape(-1, width).mean(axis=1) for values in (where, loss))
        axes.plot(place, mean, color=COLOURS[0], linewidth=1.2)
    if (loss[np.isfinite(loss)] > 0).all():
        axes.set_yscale("log")


def _draw_position_error(axes: Any, where: Floats, validation: Mapping[str, Floats]) -> None:
    errors = validation.get("position_error", np.full(len(where), np.nan))
    axes.plot(where, errors, color=COLOURS[1], marker="o", markersize=3, linewidth=1.2)
    if np.isfinite(errors).any():
        best = int(np.nanargmin(errors))
        axes.plot(where[best], errors[best], "o", color=COLOURS[1], markersize=7, fillstyle="none")
        side = "right" if 2 * best >= len(errors) else "left"
        place, label = (where[best], errors[best]), f"best {errors[best]:.3g}"
        axes.annotate(label, place, xytext=(0, 7), textcoords="offset points", fontsize=7, ha=side)
        axes.set_ylim(0, 1.2 * np.nanmax(errors))


def _draw_relative(axes: Any, where: Floats, validation: Mapping[str, Floats]) -> None:
    axes.axhline(0, color="0.6", linewidth=0.6)
    for index, (name, label) in enumerate(RELATIVE.items()):
        if name in validation:
            colour = COLOURS[2 + index]
            axes.plot(where, 100 * validation[name], color=colour, marker="o", markersize=3, linewidth=1.2, label=label)
