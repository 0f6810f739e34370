"""Survival curves, against what can be counted by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.stress.report import document, read_rows, write_rows
from gns_pl.evaluation.stress.runs import Row
from gns_pl.evaluation.stress.survival import survival


def row(duration: float, failed_at: float = math.nan, **changes) -> Row:
    values = {
        "model": "m", "identity": "1", "settings": "none", "scene": f"s{duration}{failed_at}", "axis": "tilt",
        "value": "5", "inside": True,
        "particles": 10, "steps": 5, "duration": duration, "kind": "" if math.isnan(failed_at) else "speed",
        "failed_at": failed_at, "message": "" if math.isnan(failed_at) else "a particle, fast", "exit_time": math.nan,
        "energy_rise": 0.0, "crowded": 0.0, "momentum": 0.0, "drift": math.nan, "drift_largest": math.nan,
        "seconds": 1.0,
    }  # fmt: skip
    return Row(**(values | changes))


def test_without_a_failure_all_survive_to_the_end() -> None:
    times, shares = survival([row(8.0), row(6.0)])
    assert times.tolist() == [0, 8] and shares.tolist() == [1, 1]


def test_runs_of_one_length_are_counted() -> None:
    times, shares = survival([row(8.0, 2.0), row(8.0, 5.0), row(8.0), row(8.0)])
    np.testing.assert_allclose(shares, [1, 0.75, 0.5, 0.5])
    assert times.tolist() == [0, 2, 5, 8]


def test_what_ended_before_is_not_taken_to_have_lived_on() -> None:
    # Of two left at 5 one fails: half of the 3/4 that came so far, though three of four never failed by then.
    _, shares = survival([row(8.0, 2.0), row(4.0), row(8.0, 5.0), row(8.0)])
    np.testing.assert_allclose(shares, [1, 0.75, 0.375, 0.375])


def test_a_failure_is_announced_by_the_scene_or_by_what_was_left_before() -> None:
    assert not row(8.0, 2.0).announced
    assert row(8.0, 2.0, inside=False).announced
    assert row(8.0, 2.0, exit_time=1.0).announced and not row(8.0, 2.0, exit_time=3.0).announced
    assert not row(8.0, inside=False).announced  # there is nothing to announce


def test_rows_come_back_from_the_disk(tmp_path) -> None:
    rows = [row(8.0, 2.0, inside=False, value='a "b", c'), row(6.0)]
    write_rows(tmp_path / "t.csv", rows)
    assert str(read_rows(tmp_path / "t.csv")) == str(rows)
    assert read_rows(tmp_path / "none.csv") == []


def test_another_table_is_refused(tmp_path) -> None:
    (tmp_path / "t.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="no table of the stress suite"):
        read_rows(tmp_path / "t.csv")


def test_the_report_names_what_failed_within_the_data() -> None:
    text = document([row(8.0, 2.0), row(6.0), row(8.0, 1.0, model="n", inside=False)], 5)
    assert "- `m`, s8.02.0 (5), within its data: a particle, fast." in text
    assert "`n`, s" not in text
    assert "| tilt | 2 | 1 (from 2.0 τc) | 1 (from 1.0 τc) |" in text


def test_a_table_with_the_older_names_of_its_columns_is_read(tmp_path: Path) -> None:
    rows = [row(8.0, 2.0, exit_time=1.0), row(6.0)]
    write_rows(tmp_path / "new.csv", rows)
    head, lines = (tmp_path / "new.csv").read_text().split("\n", 1)
    assert ",message,exit_time," in head
    (tmp_path / "old.csv").write_text(head.replace(",message,exit_time,", ",sentence,left_at,") + "\n" + lines)
    old, new = read_rows(tmp_path / "old.csv"), read_rows(tmp_path / "new.csv")
    assert repr(old) == repr(new) == repr(rows)  # as text, for NaN
