"""Unroll a simulator: from a one-frame `Trajectory`, or a scene, to a whole one. No metric and no figure lives here.

`engine` is the loop, for any number of scenes; `simulate` runs it from scenes to files; `acceleration` makes a step
faster, `distributed` shares it among processes, `gradient` differentiates through many, `memory` says what one takes.
"""

from gns_pl.rollout.engine import Run, rollout, unroll
from gns_pl.rollout.static import static_of

__all__ = ["Run", "rollout", "static_of", "unroll"]
