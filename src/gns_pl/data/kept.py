"""How far the particles of a trajectory file fall short of the whole run that they were kept of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gns_pl.io import TrajectoryHeader, read_observables, read_static
from gns_pl.metrics.curves import mobile
from gns_pl.metrics.maps import map_error, volume_map
from gns_pl.metrics.release import front_advance
from gns_pl.trajectory import Trajectory

FRONT = 99.0
"""Per cent of the mass behind the front that is compared."""


def kept_errors(
    path: Path, header: TrajectoryHeader, ends: NDArray[np.float32], least: float
) -> tuple[float, float] | None:
    """Return the error of the last front's advance, relative, and of the last map (`map_error`).

    Args:
        path: of a trajectory file.
        header: of the file.
        ends: first and last frame of its positions [2, N, D] [m].
        least: advance of the whole run's front below which there is nothing to compare [m].

    Returns:
        None where the file has no observables with this front, or the front has not advanced.
    """
    observables = read_observables(path)
    if observables is None or FRONT not in observables.percents:
        return None
    whole = float(observables.advance()[-1, observables.percents.index(FRONT)])
    if not whole > least:
        return None
    kept = mobile(
        Trajectory(
            position=ends,
            **read_static(path),
            material_features=header.material_features,
            dt=header.dt,
            scene=header.scene,
            provenance={},
            observables=None,
        )
    )
    position, volume = kept.position[-1].astype(np.float64), kept.volume().astype(np.float64)
    volumes = volume_map(position, volume, kept.scene, observables.cell)
    return float(front_advance(kept)[-1]) / whole - 1, map_error(volumes, observables.volume_map[-1])
