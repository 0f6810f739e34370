"""How many times as long plain MPM takes for the same error, and how far placements and reference leave that open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gns_pl.evaluation.chart.front import Setting, seconds_of_error
from gns_pl.evaluation.chart.plan import PLAIN, Plan
from gns_pl.evaluation.chart.points import line_of, point_of, rivals
from gns_pl.evaluation.chart.tables import RunRow
from gns_pl.metrics.measures import Floats

DRAWS = 400
"""Charts that are drawn by chance from the one that was measured."""

INSIDE = (5.0, 95.0)
"""Percentiles of these between which a ratio is said to lie."""


@dataclass(frozen=True)
class EqualError:
    """Time of plain MPM over the own, at the own error.

    Attributes:
        ratio: above 1 where the own is faster; infinite where no MPM of the chart is as accurate.
        low: of most drawn charts, the smallest.
        high: likewise, the largest.
        least: time of the most accurate MPM over the own: what an infinite ratio is at least.
    """

    ratio: float
    low: float
    high: float
    least: float

    def words(self) -> str:
        """Return it as a cell of a table: "2.3 (1.9 to 3.1)", or "more than 12"."""
        if math.isinf(self.ratio):
            above = f", at least {self.low:.2g}" if math.isfinite(self.low) else ""
            return f"> {self.least:.2g}{above}"
        high = f"> {self.least:.2g}" if math.isinf(self.high) else f"{self.high:.2g}"
        return f"{self.ratio:.2g} ({self.low:.2g} to {high})"


def equal_error(plan: Plan, rows: Mapping[str, Sequence[RunRow]], name: str, measure: str) -> EqualError | None:
    """Return how many times as long plain MPM takes for the error of a setting, on the scenes that this ran.

    MPM's time is that along its line of settings (`front.seconds_of_error`). The range comes from charts drawn by
    chance: of every setting and scene as many placements as there are, with replacement, and of every scene another
    reference, whose front and map differ from the measured ones by normal deviates of half their uncertainty, the same
    for all settings.

    Args:
        plan: of the chart.
        rows: name of every setting → its runs.
        name: of the setting.
        measure: key of `plan.MEASURES`.

    Returns:
        None where the setting failed, or no MPM ran its scenes.
    """
    own, line = point_of(rows[name]), rivals(rows, name, PLAIN)
    if not line or not math.isfinite(own.error(measure)):
        return None
    spots = line_of(line, measure)
    finest = min(spots, key=lambda spot: (spot.error, spot.seconds))
    random = np.random.default_rng(0)
    shifts = {
        scene.name: {part: random.normal(0.0, scene.uncertainty[part] / 2, DRAWS) for part in ("front", "map")}
        for scene in plan.scenes
    }
    drawn = {other: _drawn(runs, measure, shifts, random) for other, runs in {name: rows[name], **line}.items()}
    ratios = []
    for draw in range(DRAWS):
        seconds, error = (float(value[draw]) for value in drawn[name])
        chart = [Setting(other, float(drawn[other][0][draw]), float(drawn[other][1][draw])) for other in line]
        ratios.append(seconds_of_error(chart, error) / seconds)
    # Not interpolated, which no infinity takes.
    low, high = np.percentile(ratios, INSIDE, method="inverted_cdf")
    ratio = seconds_of_error(spots, own.error(measure)) / own.seconds
    return EqualError(ratio, float(low), float(high), finest.seconds / own.seconds)


def _drawn(
    rows: Sequence[RunRow], measure: str, shifts: Mapping[str, Mapping[str, Floats]], random: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return time and error of every drawn chart [DRAWS] each."""
    seconds, fronts, maps = [], [], []
    for scene in dict.fromkeys(row.scene for row in rows):
        runs = [row for row in rows if row.scene == scene]
        pick = random.integers(len(runs), size=(DRAWS, len(runs)))
        shift = shifts[scene]
        seconds.append(np.median(np.array([row.seconds for row in runs])[pick], axis=1))
        front = np.array([row.front_error for row in runs])[pick]
        fronts.append((1 + front) / (1 + shift["front"][:, None]) - 1)
        maps.append(np.array([row.map_error for row in runs])[pick] + shift["map"][:, None])
    errors = {key: np.sqrt(np.mean(np.hstack(of) ** 2, axis=1)) for key, of in (("front", fronts), ("map", maps))}
    error = np.maximum(errors["front"], errors["map"]) if measure == "worse" else errors[measure]
    return np.mean(seconds, axis=0), error
