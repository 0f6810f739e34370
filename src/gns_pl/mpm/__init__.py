"""The material point method in two and three dimensions: `simulate` carries a `Scene` to a `Trajectory`.

The reference solver, which makes training data and against which learned simulators are judged. Scalar pieces (`shape`,
`constitutive`, `walls`) know one point or one node each; kernels (`transfer`, `grid`) loop over them; `solver` prepares
a scene and keeps the frames. No learning, no file and no plot is known here. Scheme and limits: docs/reference.md.
"""

from gns_pl.mpm.config import COURANT_LIMIT, MPMConfig, SimulationError
from gns_pl.mpm.solver import simulate

__all__ = ["COURANT_LIMIT", "MPMConfig", "SimulationError", "simulate"]
