"""Tables that a killed run goes on with."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.tables import RunRow, Table, Tables
from tests.evaluation.chart.made_up import row


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    table = Table(tmp_path / "runs.csv", RunRow)
    rows = [row("mpm_5", "mpm", -0.1234567890123456, 1 / 3), row("failed", "learned", math.inf, 0.1, front=math.nan)]
    table.add(rows[0])
    table.add(rows[1])
    again = list(Table(tmp_path / "runs.csv", RunRow))
    assert again[0] == rows[0]
    assert again[1].front_error == math.inf and math.isnan(again[1].front)
    assert [path.name for path in tmp_path.iterdir()] == ["runs.csv"]


def test_a_row_of_the_same_key_takes_the_place_of_the_other(tmp_path: Path) -> None:
    table = Table(tmp_path / "runs.csv", RunRow)
    first = row("mpm_5", "mpm", -0.1, 1.0)
    table.add(first, replace(first, seconds=2.0))
    assert [each.seconds for each in table] == [2.0]
    others = ("identity", "machine", "judged", "scene", "device")
    table.add(
        *(replace(first, **{name: "another"}) for name in others),
        replace(first, threads=2),
        replace(first, placement=1),
    )
    assert len(table) == 8


def test_another_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text("name,seconds\nmpm_5,1.0\n")
    with pytest.raises(InputError, match=r"runs.csv: is no table of benchmark.py"):
        Tables(tmp_path)
