"""The material point method in two and three dimensions: `simulate` carries a `Scene` to a `Trajectory`.

The reference solver, which makes training data and against which learned simulators are judged. Scalar pieces (`shape`,
`constitutive`, `walls`, `obstacles`) know one point or one node each, and `laws` material laws of users; kernels loop
over them (`transfer`, `grid`) or run on a GPU (`cuda`, `batch`); `plan` prepares a scene, `solver` runs it and keeps
the frames. No learning, no file and no plot is known here. Scheme and limits: docs/reference.md.
"""

from gns_pl.mpm.config import COURANT_LIMIT, MPMConfig, SimulationError
from gns_pl.mpm.laws import register_law
from gns_pl.mpm.solver import has_cuda, simulate, simulate_batch

__all__ = ["COURANT_LIMIT", "MPMConfig", "SimulationError", "has_cuda", "register_law", "simulate", "simulate_batch"]
