"""Statistics seen in parts are those of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.data.statistics import RunningStatistics


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_parts_in_any_order_give_numpys_answer(offset: float) -> None:
    generator = np.random.default_rng(0)
    samples = offset + generator.normal([0, 1, -2], [1, 0.1, 5], (10_000, 3))
    seen = RunningStatistics(3)
    for part in np.split(samples, [0, 1, 7, 7, 4000, 9999]):
        seen.update(part)
    assert seen.count == 10_000
    np.testing.assert_allclose(seen.mean, samples.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(seen.std, samples.std(axis=0), rtol=1e-7)
    left, right = RunningStatistics(3), RunningStatistics(3)
    left.update(samples[:1000])
    right.update(samples[1000:].astype(np.float64))
    left.merge(right)
    left.merge(RunningStatistics(3))
    empty = RunningStatistics(3)
    empty.merge(left)
    for merged in (left, empty):
        np.testing.assert_allclose(merged.mean, seen.mean, rtol=1e-12)
        np.testing.assert_allclose(merged.std, seen.std, rtol=1e-7)


def test_float32_is_summed_in_double() -> None:
    samples = np.full((1_000_000, 1), 0.1, dtype=np.float32)
    seen = RunningStatistics(1)
    seen.update(samples)
    np.testing.assert_allclose(seen.mean, np.float64(np.float32(0.1)), rtol=1e-12)
    assert seen.std[0] < 1e-9


def test_empty_and_plain() -> None:
    seen = RunningStatistics(2)
    assert seen.to_dict() == {"count": 0, "mean": [0.0, 0.0], "std": [0.0, 0.0]}
    with pytest.raises(ValueError, match="must be"):
        seen.update(np.zeros((4, 3)))
