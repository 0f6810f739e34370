"""A view of a trajectory to turn and play in a notebook: all its data are in the figure, so that no server is needed.

plotly (extra `viz3d`) is imported inside the functions that draw.
"""

from __future__ import annotations

from typing import Any

from gns_pl.trajectory import Trajectory


def interactive(
    trajectory: Trajectory, *, colour: str = "displacement", max_particles: int = 5000, max_frames: int = 60
) -> Any:
    """Return."""
    raise NotImplementedError
