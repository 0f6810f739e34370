"""Depth-averaged granular flow in one and two horizontal dimensions: `simulate` carries a `Scene` to a `Trajectory`.

A rival of the learned simulators, and the fastest solver where a layer is thin: Savage and Hutter's equations for
thickness and momentum on a grid, with Coulomb friction on the floor. `plan` makes the grid of a scene, `flux` and
`stepping` are kernels, `solver` runs them, `particles` shows the layer as particles. Scheme and limits:
docs/shallow.md.
"""

from gns_pl.shallow.config import ShallowConfig
from gns_pl.shallow.plan import unsupported_reason
from gns_pl.shallow.solver import simulate

__all__ = ["ShallowConfig", "simulate", "unsupported_reason"]
