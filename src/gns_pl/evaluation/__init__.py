"""Judge trajectories: measures, curves, errors of a rollout, and the evaluation of a checkpoint against the MPM.

`measures`, `curves` and `metrics` are pure NumPy; `evaluate` brings the simulators, the files and the figures together.
Nothing here changes a simulator.
"""

from gns_pl.evaluation.curves import compute_curves
from gns_pl.evaluation.metrics import rollout_errors, summarise

__all__ = ["compute_curves", "rollout_errors", "summarise"]
