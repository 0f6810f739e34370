"""Who beats whom: against brute force and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gns_pl.evaluation.chart.front import (
    Setting,
    best_as_fast,
    break_even,
    fastest_as_good,
    pareto_front,
    seconds_of_error,
)

LINE = [
    Setting("coarse", 0.1, 0.4),
    Setting("middle", 1.0, 0.1),
    Setting("fine", 10.0, 0.025),
    Setting("slow", 20.0, 0.3),
]


def beats(one: Setting, other: Setting) -> bool:
    return one.seconds <= other.seconds and one.error <= other.error and one[1:] != other[1:]


@pytest.mark.parametrize("seed", range(20))
def test_the_front_is_what_nothing_beats(seed: int) -> None:
    generator = np.random.default_rng(seed)
    numbers = generator.integers(1, 8, size=(25, 2))  # so that there are ties
    spots = [Setting(str(n), float(t), float(e)) for n, (t, e) in enumerate(numbers)]
    spots.append(Setting("failed", 0.0, math.inf))
    wanted = {each for each in spots if not any(beats(other, each) for other in spots) and math.isfinite(each.error)}
    front = pareto_front(spots)
    assert set(front) == wanted and len(front) == len(wanted)
    assert [each.seconds for each in front] == sorted(each.seconds for each in front)


def test_equal_accuracy_and_equal_time() -> None:
    assert fastest_as_good(LINE, 0.1) == LINE[1] and fastest_as_good(LINE, 0.09) == LINE[2]
    assert fastest_as_good(LINE, 0.01) is None
    assert best_as_fast(LINE, 30.0) == LINE[2] and best_as_fast(LINE, 1.0) == LINE[1]
    assert best_as_fast(LINE, 0.05) is None
    assert best_as_fast([Setting("failed", 0.01, math.inf)], 1.0) is None


def test_between_two_settings_time_is_a_power_of_the_error() -> None:
    for spot in LINE[:3]:
        assert seconds_of_error(LINE, spot.error) == pytest.approx(spot.seconds)
    # 0.2 is half way from 0.4 to 0.1 by logarithm, so the time is the geometric mean.
    assert seconds_of_error(LINE, 0.2) == pytest.approx(math.sqrt(0.1))
    assert seconds_of_error(LINE, 0.9) == 0.1  # nothing is faster than the fastest
    assert seconds_of_error(LINE, 0.02) == math.inf
    assert seconds_of_error([], 0.1) == math.inf
    assert seconds_of_error([Setting("exact", 2.0, 0.0), LINE[0]], 0.2) == 2.0


def test_break_even_is_what_was_spent_over_what_a_scene_saves() -> None:
    assert break_even(3600.0, 1.5, 0.5) == 3600.0
    number, spent, other, own = break_even(1000.0, 0.75, 0.25), 1000.0, 0.75, 0.25
    assert spent + number * own == pytest.approx(number * other)
    assert break_even(3600.0, 0.5, 0.5) == math.inf and break_even(3600.0, 0.4, 0.5) == math.inf
    assert break_even(3600.0, math.inf, 0.5) == 0
    assert math.isnan(break_even(math.nan, 1.0, 0.5))
