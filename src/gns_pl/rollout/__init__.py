"""Unroll a simulator: from a one-frame `Trajectory`, or a scene, to a whole one. No metric and no figure lives here."""

from gns_pl.rollout.engine import rollout, static_of

__all__ = ["rollout", "static_of"]
