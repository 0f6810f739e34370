"""Maps of many runs of one place: means, and the share of the runs in which a thickness is reached."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gns_pl.errors import InputError
from gns_pl.metrics.measures import Floats
from gns_pl.metrics.rasters import FlowMaps, MapGrid

MEANS = ("max_thickness", "max_velocity", "deposit")
"""Rasters of a run of which the mean over the runs is taken."""


@dataclass(frozen=True)
class EnsembleMaps:
    """Rasters of many runs, each [X, Y].

    Attributes:
        grid: the cells of all runs.
        num_members: number of runs.
        mean: name in `MEANS` → mean over the runs; without velocity where the runs have none.
        exceedance: thickness [m] → share of the runs whose largest thickness reaches it, from 0 to 1.
    """

    grid: MapGrid
    num_members: int
    mean: dict[str, Floats]
    exceedance: dict[float, Floats]


def combine(members: Iterable[FlowMaps], thresholds: Sequence[float]) -> EnsembleMaps:
    """Return the maps of many runs on the same cells, of which one at a time is in memory.

    Every run has the same weight, so shares are probabilities as far as the runs are drawn as the truth may be.

    Args:
        members: maps of every run.
        thresholds: thicknesses [m].

    Raises:
        InputError: no run, or runs on different cells.
    """
    grid: MapGrid | None = None
    number = 0
    sums: dict[str, Floats] = {}
    counts: dict[float, Floats] = {}
    for maps in members:
        if grid is None:
            grid = maps.grid
            sums = {name: np.zeros(grid.shape) for name in MEANS if getattr(maps, name) is not None}
            counts = {threshold: np.zeros(grid.shape) for threshold in thresholds}
        if maps.grid != grid:
            raise InputError("the maps of an ensemble must be on the same cells.")
        number += 1
        for name, total in sums.items():
            total += getattr(maps, name)
        for threshold, count in counts.items():
            count += maps.max_thickness >= threshold
    if grid is None:
        raise InputError("an ensemble needs at least one run.")
    mean = {name: total / number for name, total in sums.items()}
    return EnsembleMaps(grid, number, mean, {threshold: count / number for threshold, count in counts.items()})
