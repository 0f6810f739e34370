"""Who wins, by trained solver: the fastest solver without a network as accurate, and the most accurate one as fast."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from gns_pl.evaluation.chart.front import Setting, best_as_fast, fastest_as_good
from gns_pl.evaluation.chart.plan import LEARNED
from gns_pl.evaluation.chart.points import Point, line_of, rivals
from gns_pl.evaluation.chart.tables import RatioRow, RunRow
from gns_pl.text import seconds

TIE = 0.05
"""Times that differ by less than this part are called equal: repeated measurements differ by as much."""


@dataclass(frozen=True)
class Verdict:
    """What solvers without a network have to set against a trained one.

    Attributes:
        own: the trained solver.
        measure: key of `plan.MEASURES` by which errors are meant.
        as_good: the fastest of them with equal or less error; None if none on the chart is as accurate.
        as_fast: the most accurate of them in equal or less time; None if none on the chart is as fast.
        good_ratio: time of `as_good` over the own, as far as it is known measured in turns.
        fast_ratio: the same of `as_fast`.
        in_turns: both were measured in turns in one process.
    """

    own: Point
    measure: str
    as_good: Setting | None
    as_fast: Setting | None
    good_ratio: float | None
    fast_ratio: float | None
    in_turns: bool

    @property
    def level(self) -> bool:
        """Whether one without a network is as accurate and takes as long, within `TIE`."""
        return self.good_ratio is not None and abs(self.good_ratio - 1) < TIE

    @property
    def solver_wins(self) -> bool:
        """Whether one without a network is as accurate and faster, by more than `TIE`."""
        return self.good_ratio is not None and self.good_ratio <= 1 - TIE

    def others(self) -> list[str]:
        """Return the names of those that it is to be timed with in turns; none for what failed."""
        spots = () if self.own.failed else (self.as_good, self.as_fast)
        return list(dict.fromkeys(spot.name for spot in spots if spot is not None))

    def sentence(self) -> str:
        """Return it in words."""
        error = self.own.error(self.measure)
        own = f"`{self.own.name}` errs by {percent(error)} in {seconds(self.own.seconds)}"
        if self.own.failed:
            return f"`{self.own.name}` failed in {self.own.failed} of {self.own.runs} runs"
        if self.as_good is None:
            good = "nothing without a network is as accurate"
        else:
            pace = pace_of(self.good_ratio or 1.0)
            good = f"the fastest as accurate without one, `{self.as_good.name}` ({percent(self.as_good.error)}), {pace}"
        if self.as_fast is None:
            fast = "nothing without one is as fast"
        elif self.as_good == self.as_fast:
            fast = "and none as fast is more accurate"
        else:
            factor = self.as_fast.error / error if error else float("inf")
            compared = f"{factor:.2g} times as much" if factor >= 1 else f"{1 / factor:.2g} times less"
            if abs(factor - 1) < TIE:
                compared = "about as much"
            off = f"{percent(self.as_fast.error)}, {compared}"
            fast = f"the most accurate as fast, `{self.as_fast.name}`, errs by {off}"
        return f"{own}: {good}; {fast}"


def verdicts(
    points: Sequence[Point],
    rows: Mapping[str, Sequence[RunRow]],
    ratios: Iterable[RatioRow] = (),
    measure: str = "worse",
) -> list[Verdict]:
    """Return a verdict on every trained solver, each against those without a network on the scenes that it ran.

    Args:
        points: of the chart.
        rows: name of every setting → its runs.
        ratios: measured in turns; those of earlier settings are not looked at where the chart's points are others.
        measure: key of `plan.MEASURES`.
    """
    known = {(row.name, row.other): row.ratio for row in ratios}
    found = []
    for own in points:
        if own.group not in LEARNED:
            continue
        line = line_of(rivals(rows, own.name), measure)
        good, fast = fastest_as_good(line, own.error(measure)), best_as_fast(line, own.seconds)
        pairs = [(own.name, each.name) for each in (good, fast) if each is not None]
        by_good, by_fast = (
            None if each is None else known.get((own.name, each.name), each.seconds / own.seconds)
            for each in (good, fast)
        )
        in_turns = all(pair in known for pair in pairs)
        found.append(Verdict(own, measure, good, fast, by_good, by_fast, in_turns))
    return found


def pace_of(ratio: float) -> str:
    """Return the time of another over the own in words."""
    if abs(ratio - 1) < TIE:
        return "takes as long"
    return f"takes {ratio:.3g} times as long" if ratio > 1 else f"is {1 / ratio:.3g} times faster"


def percent(value: float) -> str:
    """Return a share in per cent, "failed" if it is infinite."""
    if value == float("inf"):
        return "failed"
    return "–" if value != value else f"{100 * value:.1f} %"
