"""From rows to points, verdicts, words and a figure."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.draw import draw
from gns_pl.evaluation.chart.markdown import caption, scenes_of
from gns_pl.evaluation.chart.plan import read_plan, write_plan
from gns_pl.evaluation.chart.points import points_of, rows_by_name
from gns_pl.evaluation.chart.tables import RatioRow, Tables
from gns_pl.evaluation.chart.verdicts import verdicts
from tests.evaluation.chart.made_up import PLACE, folder, plan, row


def test_a_point_is_the_root_mean_square_and_the_median(tmp_path: Path) -> None:
    points = {each.name: each for each in points_of(plan(), folder(tmp_path).runs)}
    good = points["good"]
    assert good.front_error == pytest.approx(math.sqrt((0.05**2 + 0.055**2) / 2))
    assert good.map_error == pytest.approx(good.front_error / 4) and good.error("worse") == good.front_error
    assert good.largest_error == pytest.approx(0.055) and good.bias == pytest.approx(0.0525)
    assert (good.seconds, good.runs, good.failed) == (0.5, 4, 0)
    assert {name for name, each in points.items() if "front" in each.on_fronts} == {"still", "mpm_5", "good"}


def test_what_was_spent_pays_where_mpm_of_equal_error_is_slower(tmp_path: Path) -> None:
    points = {each.name: each for each in points_of(plan(), folder(tmp_path).runs)}
    assert points["good"].equal_seconds == math.inf and points["good"].break_even == 0
    assert scenes_of(points["good"]) == "at once"
    poor = points["poor"]
    assert 0.1 < poor.equal_seconds < 0.8 and poor.break_even == math.inf and scenes_of(poor) == "never"
    assert points["law_lube"].data_seconds == 0 and points["law_fitted"].data_seconds == 8


def test_two_runs_are_extrapolated_placement_by_placement(tmp_path: Path) -> None:
    rows = rows_by_name(plan(), folder(tmp_path).runs)["extrapolated_5_10"]
    # Errors of -40 and -20 % halve with the cell, so they are gone.
    assert [each.front_error for each in rows] == pytest.approx([0, 0, 0, 0], abs=1e-12)
    assert all(each.seconds == pytest.approx(0.9) and math.isnan(each.height_error) for each in rows)


def test_rows_of_other_settings_machines_and_placements_are_not_on_the_chart(tmp_path: Path) -> None:
    tables, first = folder(tmp_path), row("good", "learned", 9.0, 9.0)
    tables.runs.add(
        replace(first, identity="trained again"), replace(first, machine="another"), replace(first, threads=2),
        replace(first, judged="by another"), replace(first, placement=2), replace(first, name="gone"),
    )  # fmt: skip
    assert max(each.front_error for each in points_of(plan(), tables.runs) if each.name == "good") < 0.06


def test_a_failed_run_is_infinitely_wrong_and_on_no_front(tmp_path: Path) -> None:
    tables = folder(tmp_path)
    tables.runs.add(row("good", "learned", math.inf, 0.5))
    points, rows = points_of(plan(), tables.runs), rows_by_name(plan(), tables.runs)
    good = next(each for each in points if each.name == "good")
    assert good.front_error == math.inf and good.failed == 1 and not good.on_fronts
    found = verdicts(points, rows)
    assert "failed in 1 of 4 runs" in next(each for each in found if each.own.name == "good").sentence()
    assert "Failed: good." in caption(found, points, 0.01, "worse")


def test_verdicts_follow_the_data_and_what_was_timed_in_turns(tmp_path: Path) -> None:
    table = folder(tmp_path).runs
    points, rows = points_of(plan(), table), rows_by_name(plan(), table)
    good, poor = verdicts(points, rows)
    assert good.as_good is None and good.as_fast is not None and good.as_fast.name == "mpm_5" and not good.solver_wins
    assert poor.as_good is not None and poor.as_good.name == "mpm_10" and poor.solver_wins and not poor.in_turns
    assert poor.others() == ["mpm_10"]
    timed = RatioRow("poor", "of poor", "mpm_10", "of mpm_10", plan().together(), PLACE.machine, 1, 0.9, 1.8, 2.0, 5)
    again = verdicts(points, rows, plan().ratios([timed]))[1]  # type: ignore[arg-type]
    assert again.in_turns and again.good_ratio == 2.0 and not again.solver_wins
    tie = verdicts(points, rows, plan().ratios([replace(timed, ratio=0.97)]))[1]  # type: ignore[arg-type]
    assert (
        tie.level
        and not tie.solver_wins
        and "Level with MPM as accurate: poor." in caption([tie], points, 0.01, "worse")
    )
    text = caption([good, poor], points, 0.01, "worse")
    assert "MPM wins, as accurate in less time, against 1 of 2 trained solvers: poor (is 1.12 times faster)." in text
    assert "good is ahead: no MPM here is as accurate." in text


def test_a_plan_comes_back_as_it_was(tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.json", plan())
    again = read_plan(tmp_path / "plan.json")
    assert math.isnan(again.costs["poor"].train_seconds)
    assert replace(again, costs={}) == replace(plan(), costs={})
    assert again.band("front") == again.band("worse") == pytest.approx(math.sqrt((0.01**2 + 0.02**2) / 2))
    (tmp_path / "plan.json").write_text("{}")
    with pytest.raises(InputError, match=r"is no plan of benchmark\.py"):
        read_plan(tmp_path / "plan.json")


def test_page_figure_and_table_are_drawn_from_the_tables(tmp_path: Path) -> None:
    made = draw(plan(), folder(tmp_path), tmp_path, logger=None)
    assert [path.name for path in made] == ["chart.md", "chart.csv", "chart.png", "chart.svg", "chart_details.png"]
    page = (tmp_path / "chart.md").read_text()
    assert "| **`good`** | 2 | 100 | 0.5 | 5.3 % | 1.3 % |" in page
    assert "- `other` is not run: trained with other walls." in page
    assert page.count("### By ") == 3 and page.count("- `poor` errs by") == 3
    assert "- `poor` is run outside of its range on high: trained on low columns." in page
    assert "Fewer than five" in page and "| `poor` | 60 s | unknown |" in page
    assert (tmp_path / "chart.png").stat().st_size > 20_000
    names = np.genfromtxt(tmp_path / "chart.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")["name"]
    assert names[0] in ("law_lube", "law_fitted") and len(names) == 10


def test_no_rows_no_chart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no run of the chart"):
        draw(plan(), Tables(tmp_path), tmp_path, logger=None)
