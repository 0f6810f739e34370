"""The weights that a training begins with, where these are not random: those of another one."""

from __future__ import annotations

import math

from gns_pl.errors import InputError
from gns_pl.models.checkpoint import Checkpoint
from gns_pl.models.registry import kind_of
from gns_pl.models.simulator import Simulator

SPACINGS = 0.01
"""So far relative to each other may the spacings of two data sets be."""


def begin_from(simulator: Simulator, checkpoint: Checkpoint, name: str) -> None:
    """Give a simulator the weights and the normalisation of a checkpoint.

    Args:
        simulator: of the data that are now trained on; stays as it is built.
        checkpoint: of another training.
        name: of its file, for messages.

    Raises:
        InputError: one of another build.
    """
    then, now = ({"kind": kind_of(each), **vars(each.config)} for each in (checkpoint.simulator, simulator))
    for key in sorted(now):
        if key == "neighbours" or now[key] == then.get(key):
            continue
        slack = {"dt": 1e-6, "spacing": SPACINGS}.get(key)
        if slack is not None and math.isclose(now[key], then[key], rel_tol=slack):
            continue
        owner = "the data have" if key in ("dim", "dt", "spacing", "particle_types") else "this training has"
        raise InputError(
            f"ckpt={name}: was trained with {key}={then.get(key)}, and {owner} {now[key]}; set it alike, or begin from "
            "another checkpoint, or from none (ckpt=null)."
        )
    simulator.load_state_dict(checkpoint.simulator.state_dict())
