"""Figures and animations of trajectories and of their curves. Nothing is measured here, and nothing is simulated.

matplotlib and pillow (extra `viz`) are imported inside the functions that draw.
"""

from gns_pl.viz.animation import write_animation
from gns_pl.viz.plots import plot_curves, plot_evolution

__all__ = ["plot_curves", "plot_evolution", "write_animation"]
