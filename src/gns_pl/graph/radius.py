"""The connectivity radius that is advised for particles of a spacing."""

from __future__ import annotations

RADIUS = 2.1
"""Radius that is advised, in spacings. A lattice has pairs at 2 and at √5 spacings and none between, so that rounding
decides about none."""


def advised_radius(spacing: float) -> float:
    """Return a connectivity radius for particles of a spacing, to three digits [m]."""
    return float(f"{RADIUS * spacing:.3g}")
