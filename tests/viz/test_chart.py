"""The figure of speed against accuracy: whatever there is to draw."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gns_pl.viz import Mark, plot_chart
from gns_pl.viz.chart import GROUPS


def mark(number: int, group: str, **changes: object) -> Mark:
    values: dict[str, object] = {
        "name": f"{group}_{number}", "group": group, "seconds": 0.1 * (number + 1), "low": 0.09, "high": 0.2,
        "error": 0.3, "label": f"{group}_{number}", "whole": False, "on_front": False, "spent": 0.0, "pays": "never",
    }  # fmt: skip
    return Mark(**values | changes)  # type: ignore[arg-type]


def test_every_group_has_its_mark(tmp_path: Path) -> None:
    marks = [mark(number, group, spent=10.0 * number, on_front=number == 0) for number, group in enumerate(GROUPS)]
    marks += [mark(9, "learned", error=math.inf), mark(9, "law", seconds=1e-7), mark(9, "mpm", error=0.0, whole=True)]
    marks += [mark(9, "of_a_user")]
    rates = {"mpm_0": ("mpm", [(2, 3.0), (1, 2.0)]), "learned_1": ("learned", [(1, 1.0)])}
    paths = [tmp_path / "chart.png", tmp_path / "chart.svg"]
    plot_chart(marks, rates, band=0.015, title="two columns", caption="Who wins. " * 60, paths=paths)
    assert all(path.stat().st_size > 20_000 for path in paths)
    drawn = paths[1].read_text()
    names = ("mpm_0", "law_9", "of_a_user_9", "two columns")
    assert all(f"<!-- {name} -->" in drawn for name in names) and "learned_9" not in drawn


@pytest.mark.parametrize("band", [0.0, 0.5])
def test_a_chart_of_one_setting_without_batches_and_costs(tmp_path: Path, band: float) -> None:
    plot_chart([mark(0, "mpm")], {}, band=band, title="", caption="", paths=[tmp_path / "chart.png"])
    assert (tmp_path / "chart.png").exists()
