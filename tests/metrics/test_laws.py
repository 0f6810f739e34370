"""Published runout laws: what their sources print, and that no column lies on a jump."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from gns_pl.metrics.laws import LAWS, Law


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.source)
def test_low_columns_run_out_in_proportion_and_high_ones_by_a_power(law: Law) -> None:
    assert law(0.4) == pytest.approx(2 * law(0.2))
    assert law(0.2) == pytest.approx(0.2 * law.low)
    assert law(40) / law(20) == pytest.approx(2**law.power)
    assert law(20) == pytest.approx(law.high * 20**law.power)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.source)
def test_both_ranges_meet(law: Law) -> None:
    """By the lower one carried on: within the gap that sources leave nothing jumps, and more height runs farther."""
    ratios = np.linspace(0.5, 10, 2000)
    runouts = [law(ratio) for ratio in ratios]
    steps = np.diff(runouts)
    assert (steps > 0).all() and steps.max() < 2 * law.low * (ratios[1] - ratios[0])


def test_experiments_run_less_far_than_models() -> None:
    """Of the four, the μ(I) continuum runs farthest and the channel of Lube et al. least, at every aspect ratio."""
    by_source = {law.source.split(",")[0].split(" et al")[0]: law for law in LAWS}
    lube, continuum = by_source["Lube"], by_source["μ(I) continuum"]
    for ratio, law in itertools.product((0.3, 0.8, 2, 5, 15), LAWS):
        assert lube(ratio) <= law(ratio) <= continuum(ratio)


@pytest.mark.parametrize(("law", "split"), zip(LAWS, (3.97, 2.09, 4.23, 6.74), strict=True))
def test_the_aspect_ratio_at_which_the_ranges_meet(law: Law, split: float) -> None:
    """By hand: low a = high a^p at a = (high / low)^(1 / (1 − p))."""
    assert law(0.99 * split) == pytest.approx(0.99 * split * law.low)
    assert law(1.01 * split) == pytest.approx(law.high * (1.01 * split) ** law.power)
    assert law.low * split == pytest.approx(law.high * split**law.power, rel=1e-3)
