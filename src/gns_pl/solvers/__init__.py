"""Whatever leads from a scene to a trajectory: MPM, learned simulators, corrected MPM, and the choice among them.

How one step is made stands in `models` and `mpm`, how steps are unrolled in `rollout`.
"""
