"""What can be learned and stored: one step of a simulator, and the corrector of coarse MPM; their files.

A model has no loop over steps and no data set: `rollout` unrolls it, `training` fits it.
"""
