"""Runs from several placements: their mean, their range, and what one that failed takes away."""

from __future__ import annotations

import statistics

import numpy as np
import pytest

from gns_pl.evaluation.placements import Placements
from gns_pl.metrics.curves import cut
from gns_pl.metrics.summary import COMPARISON, FLOW, Measured
from tests.evaluation.made_up import moved, spreading


def test_runs_that_are_the_reference_have_no_error_and_no_range() -> None:
    flow = spreading()
    placements = Placements.of([flow, flow], Measured(flow))
    assert set(placements.values) == set(FLOW)
    errors = [quantity.name for quantity in COMPARISON if quantity.name in FLOW]
    assert len(errors) > 5
    for name in errors:
        assert placements.values[name] == pytest.approx([0.0, 0.0], abs=1e-9)
    for low, high in placements.band.values():
        np.testing.assert_array_equal(low, high)


def test_the_mean_lies_in_the_range_and_the_range_is_reached() -> None:
    reference = spreading()
    placements = Placements.of([spreading(share=share) for share in (0.5, 0.8, 1.0)], Measured(reference))
    assert placements.curves is not None
    low, high = placements.band["runout_99"]
    mean = placements.curves["runout_99"]
    assert (low <= mean + 1e-12).all() and (mean <= high + 1e-12).all() and low[-1] < mean[-1] < high[-1]
    whole = Measured(reference).curves["runout_99"]
    np.testing.assert_allclose(high, whole)
    errors = placements.values["runout_99_error"]
    assert errors == sorted(errors) and errors[-1] == pytest.approx(0, abs=1e-6)
    assert placements.over(statistics.mean)["runout_99_error"] == pytest.approx(mean[-1] / whole[-1] - 1)


def test_a_run_that_ends_early_counts_in_nothing_but_its_place() -> None:
    reference = spreading()
    short = cut(spreading(share=0.1), 7)
    broken = moved(spreading(share=0.1), np.where(np.arange(30) < 20, 0.0, np.nan)[:, None] * np.ones(3))
    placements = Placements.of([reference, short, broken], Measured(reference))
    alone = Placements.of([reference], Measured(reference))
    assert placements.curves is not None and alone.curves is not None
    np.testing.assert_array_equal(placements.curves["runout_99"], alone.curves["runout_99"])
    for name in FLOW:
        assert np.isnan(placements.values[name][1:]).all() and len(placements.values[name]) == 3
    assert placements.over(max) == alone.over(max)


def test_a_longer_run_is_judged_at_the_references_end() -> None:
    longer = spreading()
    reference = cut(longer, 20)
    assert Placements.of([longer], Measured(reference)).over(abs_max)["runout_99_error"] == pytest.approx(0, abs=1e-9)


def test_where_all_failed_there_is_no_mean() -> None:
    reference = spreading()
    placements = Placements.of([cut(reference, 5)], Measured(reference))
    assert placements.curves is None and placements.band == {} and placements.over(max) == {}


def abs_max(values: list[float]) -> float:
    """Return the largest absolute value."""
    return max(map(abs, values))
