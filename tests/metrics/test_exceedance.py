"""Two runs by hand, and runs that do not belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.metrics.exceedance import combine
from gns_pl.metrics.rasters import FlowMaps, MapGrid

GRID = MapGrid((0.0, 0.0), 2.0, (3, 1))


def run(largest: list[float], deposit: list[float], grid: MapGrid = GRID) -> FlowMaps:
    thickness, left = (np.array(values, dtype=float)[:, None] for values in (largest, deposit))
    return FlowMaps(grid, 0.1, 0 * left, thickness, 3 * thickness, left, np.full_like(left, np.nan))


def test_two_members_by_hand() -> None:
    one, two = run([2.0, 1.0, 0.0], [1.0, 1.0, 0.0]), run([0.5, 0.2, 0.1], [0.5, 0.0, 0.1])
    maps = combine([one, two], [0.2, 1.0])
    assert maps.num_members == 2 and maps.grid == GRID
    assert maps.exceedance[0.2].ravel().tolist() == [1.0, 1.0, 0.0]
    assert maps.exceedance[1.0].ravel().tolist() == [0.5, 0.5, 0.0]
    assert maps.mean["max_thickness"].ravel().tolist() == [1.25, 0.6, 0.05]
    assert maps.mean["deposit"].ravel().tolist() == [0.75, 0.5, 0.05]
    np.testing.assert_allclose(maps.mean["max_velocity"].ravel(), [3.75, 1.8, 0.15])
    assert set(combine([replace(one, max_velocity=None)], [1.0]).mean) == {"max_thickness", "deposit"}


def test_members_share_their_cells() -> None:
    other = run([1, 1, 1], [1, 1, 1], MapGrid((0.0, 0.5), 2.0, (3, 1)))
    with pytest.raises(InputError, match="must be on the same cells"):
        combine([run([1, 1, 1], [1, 1, 1]), other], [0.1])
    with pytest.raises(InputError, match="at least one run"):
        combine([], [0.1])
