"""How many times as long MPM takes for the same error, and within what."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gns_pl.evaluation.chart.plan import Plan
from gns_pl.evaluation.chart.tables import RunRow
from gns_pl.evaluation.chart.uncertain import equal_error
from tests.evaluation.chart.made_up import SCENES, plan, row


def sure(uncertainty: float) -> Plan:
    """A plan whose references are known so well."""
    known = dict.fromkeys(SCENES[0].uncertainty, uncertainty)
    return plan(scenes=tuple(replace(scene, uncertainty=known) for scene in SCENES))


def runs(error: float, seconds: float, name: str, group: str = "mpm", scatter: float = 0.0) -> list[RunRow]:
    return [
        row(
            name, group, error + scatter * (number - 2), seconds, scene=scene.name, judged=scene.judged,
            placement=number,
        )
        for scene in SCENES
        for number in range(5)
    ]  # fmt: skip


LINE = {"mpm_5": runs(-0.4, 0.1, "mpm_5"), "mpm_10": runs(-0.2, 0.8, "mpm_10"), "mpm_20": runs(-0.1, 6.4, "mpm_20")}


def test_without_scatter_and_doubt_the_ratio_is_that_along_the_line() -> None:
    rows = {**LINE, "own": runs(-0.2, 0.1, "own", "learned")}
    found = equal_error(sure(0.0), rows, "own", "front")
    assert found is not None
    assert [found.ratio, found.low, found.high] == pytest.approx([8.0, 8.0, 8.0])
    between = equal_error(sure(0.0), {**LINE, "own": runs(-math.sqrt(0.02), 0.1, "own", "learned")}, "own", "front")
    assert between is not None and between.ratio == pytest.approx(math.sqrt(8.0 * 64.0))


def test_scatter_and_doubt_widen_it() -> None:
    # It goes too far where MPM stops short, so another reference is good for one and bad for the other.
    rows = {**LINE, "own": runs(0.15, 0.1, "own", "learned", scatter=0.02)}
    of_scatter = equal_error(sure(0.0), rows, "own", "front")
    of_both = equal_error(sure(0.1), rows, "own", "front")
    assert of_scatter is not None and of_both is not None
    assert of_scatter.low < of_scatter.ratio < of_scatter.high
    assert of_both.low < 0.9 * of_scatter.low and of_both.high > 1.1 * of_scatter.high
    assert of_scatter.words().startswith(f"{of_scatter.ratio:.2g} (")


def test_what_is_more_accurate_than_all_mpm_is_told_by_the_most_accurate() -> None:
    found = equal_error(sure(0.0), {**LINE, "own": runs(-0.05, 0.1, "own", "learned")}, "own", "front")
    assert found is not None and math.isinf(found.ratio) and found.words() == "> 64"


def test_what_failed_or_has_nobody_to_compare_with_has_no_ratio() -> None:
    assert equal_error(sure(0.0), {**LINE, "own": runs(math.inf, 0.1, "own", "learned")}, "own", "front") is None
    assert equal_error(sure(0.0), {"own": runs(-0.1, 0.1, "own", "learned")}, "own", "front") is None
