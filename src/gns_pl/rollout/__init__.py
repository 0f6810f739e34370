"""Unroll a simulator: from a one-frame `Trajectory`, or a scene, to a whole one. No metric and no figure lives here."""

from gns_pl.rollout.engine import Run, rollout, static_of, unroll

__all__ = ["Run", "rollout", "static_of", "unroll"]
