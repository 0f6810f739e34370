"""From a deposit back to what left it: unknowns of a scene by gradients through the rollout, or by runs alone.

`deposit` makes a smooth measure of final positions, `problem` asks which unknowns explain one that was observed and
differentiates through the learned simulator, `fit` goes down the misfit. Nothing here trains a network.
"""

from gns_pl.inverse.deposit import deposit_misfit, deposit_thickness
from gns_pl.inverse.fit import Bounds, Fit, adam, lbfgs, solve
from gns_pl.inverse.problem import ByDifferences, ByGradient, Problem

__all__ = [
    "Bounds",
    "ByDifferences",
    "ByGradient",
    "Fit",
    "Problem",
    "adam",
    "deposit_misfit",
    "deposit_thickness",
    "lbfgs",
    "solve",
]
