"""Runs that were not made but follow from others: two sizes of cells, extrapolated to a cell of no size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from gns_pl.evaluation.chart.tables import RunRow
from gns_pl.solvers.trivial import extrapolate


def extrapolated(coarse: Sequence[RunRow], fine: Sequence[RunRow], ratio: float, order: float) -> list[RunRow]:
    """Return what two sizes of cells say of a cell of no size, placement by placement; the time is that of both.

    Args:
        coarse: runs on the coarser cells.
        fine: on the finer ones, of the same scenes and placements; those of others are left out.
        ratio: of the cells, above 1.
        order: of the error.
    """
    others = {(row.scene, row.placement): row for row in coarse}
    found, nothing = [], math.nan
    for row in fine:
        other = others.get((row.scene, row.placement))
        if other is None:
            continue
        front = extrapolate(other.front, row.front, ratio, order)
        true = row.front / (1 + row.front_error)
        error = front / true - 1 if math.isfinite(front) else math.inf
        name = f"extrapolated_{other.name.removeprefix('mpm_')}_{row.name.removeprefix('mpm_')}"
        both = replace(row, name=name, group="extrapolated", front=front, front_error=error, map_error=nothing)
        both = replace(both, curve_error=nothing, height_error=nothing, arrest_error=nothing, profile_error=nothing)
        both = replace(both, file_seconds=nothing)
        times = {
            name: getattr(row, name) + getattr(other, name) for name in ("seconds", "cpu_seconds", "first_seconds")
        }
        found.append(replace(both, **times))
    return found
