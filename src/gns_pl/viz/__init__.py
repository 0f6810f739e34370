"""Figures and animations of trajectories, of their curves, of trainings and of sweeps. Nothing is measured here.

matplotlib and pillow (extra `viz`), PyVista, plotly and imageio-ffmpeg (extra `viz3d`) are imported inside the
functions that draw. ParaView series need none of them.
"""

from importlib.util import find_spec

from gns_pl.viz.animation import write_animation
from gns_pl.viz.chart import Panel, plot_chart, plot_details
from gns_pl.viz.evolution import plot_evolution
from gns_pl.viz.laws import plot_laws
from gns_pl.viz.learning_curve import plot_learning_curve
from gns_pl.viz.marks import Mark
from gns_pl.viz.notebook import interactive
from gns_pl.viz.ood import plot_ood
from gns_pl.viz.paraview import write_paraview
from gns_pl.viz.plots import plot_curves
from gns_pl.viz.scene3d import render_film, render_still
from gns_pl.viz.survival import plot_survival
from gns_pl.viz.sweep import SweepPoint, plot_sweep

__all__ = [
    "Mark",
    "Panel",
    "SweepPoint",
    "interactive",
    "missing_packages",
    "plot_chart",
    "plot_curves",
    "plot_details",
    "plot_evolution",
    "plot_laws",
    "plot_learning_curve",
    "plot_ood",
    "plot_survival",
    "plot_sweep",
    "render_film",
    "render_still",
    "write_animation",
    "write_paraview",
]


def missing_packages() -> list[str]:
    """Return the names of the packages that drawing needs and that are not installed."""
    return [name for name, module in (("matplotlib", "matplotlib"), ("pillow", "PIL")) if find_spec(module) is None]
