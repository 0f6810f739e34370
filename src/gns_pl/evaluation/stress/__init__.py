"""The stress suite: a fixed list of scenes on which methods are known to fail, and what becomes of each.

Material point method and learned simulators run the same scenes and are looked at by the same `rollout.failure`. No
reference is needed: this is about runs that cannot be right, not about how right they are.
"""
