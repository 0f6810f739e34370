"""Bands of several runs: those of one and the same have no width, a failed member is told."""

from __future__ import annotations

import numpy as np

from gns_pl.evaluation.bands import ensemble_bands
from gns_pl.metrics.curves import compute_curves
from gns_pl.rollout import rollout
from gns_pl.scene import Scene
from tests.conftest import make_simulator, make_start


def test_equal_members_have_no_width_and_others_have(column: Scene) -> None:
    same, start = make_simulator(), make_start(column)
    bands = ensemble_bands([same, same, same], [start], duration=0.1)
    assert bands.members.shape == (3, 11) and bands.failed == 0 and bands.width == 0
    expected = compute_curves(rollout(same, start, 10))["runout_99"]
    for curve in (bands.mean, bands.low, bands.high):
        np.testing.assert_allclose(curve, expected, atol=1e-12)
    coarser = make_simulator(dt=0.02)
    other = ensemble_bands([same, coarser], [start], duration=0.1)
    assert other.width > 0 and (other.low <= other.mean).all() and (other.mean <= other.high).all()
    assert other.members.shape == (2, 11)


def test_a_member_that_fails_is_not_averaged(column: Scene) -> None:
    wild, start = make_simulator(), make_start(column)
    wild.acceleration_scale.fill_(1e38)
    bands = ensemble_bands([make_simulator(), wild], [start], duration=0.1)
    assert bands.failed == 1 and bands.width == float("inf")
    np.testing.assert_array_equal(bands.mean, bands.members[0])
