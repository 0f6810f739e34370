"""What of a deposit a coarse solver is fitted to: how far it reached, how high it lies, and where it lies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gns_pl.metrics.curves import mobile
from gns_pl.metrics.maps import map_error, volume_map
from gns_pl.metrics.measures import Floats, centre_of_mass
from gns_pl.metrics.release import front_advance
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class Observed:
    """A final deposit.

    Attributes:
        front: advance of the front within which 99 % of the mass lies (`metrics.release.front_advance`) [m].
        height: mass-weighted mean height over the floor [m].
        volumes: at the nodes of a horizontal grid (`metrics.maps.volume_map`) [X, Y] [m³]; in plane strain [X] [m²].
    """

    front: float
    height: float
    volumes: Floats


def observe(trajectory: Trajectory) -> Observed:
    """Return what is observed of the last frame; a scene in plane strain is measured on its slice.

    Args:
        trajectory: finite in its first and last frame.
    """
    ends = replace(trajectory, position=trajectory.position[[0, -1]])
    flow = mobile(reduce_scene(trajectory.scene).flatten(ends))
    last, volume = flow.position[-1].astype(np.float64), flow.volume().astype(np.float64)
    height = centre_of_mass(flow)[-1, -1]
    return Observed(float(front_advance(flow)[-1]), float(height), volume_map(last, volume, flow.scene))


def errors(observed: Observed, reference: Observed) -> Floats:
    """Return the relative errors of front and mean height, and the part of the volume that is misplaced [3]."""
    misplaced = map_error(observed.volumes, reference.volumes)
    return np.array([observed.front / reference.front - 1, observed.height / reference.height - 1, misplaced])
