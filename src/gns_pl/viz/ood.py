"""How far runs are from what a network saw in training, over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gns_pl.viz.plots import COLOURS, STYLE, Floats


def plot_ood(distances: Mapping[str, tuple[Floats, Floats, Floats]], limit: float, path: Path) -> None:
    """Draw the mean distance and the share of particles out of the training range over t/τc, a line for each scene.

    Args:
        distances: scene → times [τc], mean distances and shares, all [T].
        limit: share above which a run has left the training range.
        path: file to write; the ending says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        for number, (name, (time, mean, share)) in enumerate(distances.items()):
            style = {"color": COLOURS[number % len(COLOURS)], "linestyle": ("-", "--", ":")[number // len(COLOURS) % 3]}
            left.plot(time, mean, linewidth=1.2, label=name, **style)
            right.plot(time, 100 * share, linewidth=1.2, **style)
        left.axhline(1.0, color="0.6", linewidth=0.8, linestyle=(0, (4, 3)))
        right.axhline(100 * limit, color="0.6", linewidth=0.8, linestyle=(0, (4, 3)))
        left.set(ylabel="mean distance to training", xlabel="time $t/\\tau_c$")
        right.set(ylabel="particles out of range [%]", xlabel="time $t/\\tau_c$")
        for axes in (left, right):
            axes.set_ylim(bottom=0)
            axes.set_xlim(left=0)
        left.legend(loc="best")
        figure.savefig(path)
