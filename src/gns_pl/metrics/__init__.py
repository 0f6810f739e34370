"""What is measured on a trajectory: fronts, heights, profiles, energies, their course, and errors against another one.

NumPy alone. What runs a scene, or writes a page about it, is elsewhere.
"""

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.summary import rollout_errors, summarise

__all__ = ["compute_curves", "rollout_errors", "summarise"]
