"""The figures of speed against accuracy: what is drawn, what is named, and that all of it can be read."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.viz import Mark, Panel, plot_chart, plot_details
from gns_pl.viz.chart import WIDTH, chart_figure, details_figure
from gns_pl.viz.labels import _crossed, _hit
from gns_pl.viz.marks import ASIDE, GROUPS, shortened
from tests.viz.charts import crowded, published

MEASURES = {"front": "final front", "map": "final deposit from above, the share of its volume in the wrong place"}
BANDS = {"front": 0.015, "map": 0.02}
SETS = {"crowded": crowded, "published": published}
PHONE = 360
"""Width of a telephone's page [px]."""


def mark(number: int, group: str, **changes: object) -> Mark:
    values: dict[str, object] = {
        "name": f"{group}_{number}", "group": group, "seconds": 0.1 * (number + 1), "low": 0.09, "high": 0.2,
        "label": f"{group}_{number}", "whole": False, "on_fronts": (), "spent": 0.0, "pays": "never",
    }  # fmt: skip
    error = changes.pop("error", 0.3)
    errors = {"front": error, "map": math.inf if group in ("law", "extrapolated") else error, "worse": error}
    return Mark(**values | {"errors": errors} | changes)  # type: ignore[arg-type]


def names(axes: Any) -> list[Any]:
    return [text for text in axes.texts if text.get_text()]


def test_every_group_has_its_mark(tmp_path: Path) -> None:
    marks = [
        mark(number, group, spent=10.0 * number, on_fronts=["front", "worse"] if number == 0 else [])
        for number, group in enumerate(GROUPS)
    ]
    marks += [mark(9, "learned", error=math.inf), mark(9, "law", seconds=1e-7), mark(9, "of_a_user")]
    marks += [mark(11, "mpm", error=0.0, whole=True)]
    rates = {"mpm_0": ("mpm", [(2, 3.0), (1, 2.0)]), "learned_1": ("learned", [(1, 1.0)]), "u": ("of_a_user", [(1, 4)])}
    headline, details = (tmp_path / name for name in ("chart.svg", "details.svg"))
    plot_chart([Panel("two columns", marks, 0.015)], [headline, tmp_path / "chart.png"])
    plot_details(marks, BANDS, MEASURES, rates, [details])
    assert all(path.stat().st_size > 20_000 for path in (headline, details, tmp_path / "chart.png"))
    shown = {path: path.read_text() for path in (headline, details)}
    assert all(f"<!-- {words} -->" in shown[details] for words, _, _ in GROUPS.values())
    assert all(f"<!-- {name} -->" in shown[details] for name in ("1/0", "1/11", "law_9", "of_a_user_9"))
    assert all(f"<!-- {name} -->" in shown[headline] for name in ("1/0", "of_a_user_9", "two columns"))
    assert "learned_9" not in shown[headline] + shown[details], "failed"
    assert "<!-- 1/11 -->" not in shown[headline], "MPM off the Pareto front has a mark and no name"
    assert not any(f"<!-- {group}_" in shown[headline] for group in (*ASIDE, "extrapolated"))


@pytest.mark.parametrize("band", [0.0, 0.5])
def test_there_are_no_empty_panels(band: float) -> None:
    bands = dict.fromkeys(MEASURES, band)
    one = [mark(0, "mpm")]
    assert len(chart_figure([Panel("", one, band)]).axes) == 1
    assert not chart_figure([Panel("", one, band)], legend=False).legends
    assert len(details_figure(one, bands, MEASURES, {}).axes) == 2
    assert len(details_figure(one, bands, MEASURES, {"mpm_0": ("mpm", [(1, 2.0)])}).axes) == 3
    assert len(details_figure([*one, mark(1, "learned", spent=5.0)], bands, MEASURES, {}).axes) == 3
    nothing = chart_figure([Panel("all failed", [mark(0, "mpm", error=math.inf)], band)])
    assert not nothing.axes[0].lines


@pytest.mark.parametrize("name", SETS)
def test_names_neither_overlap_nor_cover_a_mark_nor_leave_their_axes(name: str) -> None:
    marks = SETS[name]()
    assert len(marks) == 35 or name == "published"
    rates = {each.name: (each.group, [(1, each.seconds), (8, 1.2 * each.seconds)]) for each in marks[:20:2]}
    headline = chart_figure([Panel("one", marks, 0.03)])
    details = details_figure(marks, BANDS, MEASURES, rates)
    needed = [each for each in marks if each.group not in (*ASIDE, "extrapolated")]
    needed = [each for each in needed if each.group != "mpm" or "worse" in each.on_fronts]
    assert {text.get_text() for text in names(headline.axes[0])} == {shortened(each.label) for each in needed}
    for axes, measure in zip(details.axes, MEASURES, strict=False):
        finite = [each for each in marks if math.isfinite(each.errors[measure])]
        assert {text.get_text() for text in names(axes)} == {shortened(each.label) for each in finite}
    for figure in (headline, details):
        figure.set_dpi(200)
        figure.canvas.draw()
        renderer = figure.canvas.get_renderer()
        for axes in figure.axes:
            boxes = [text.get_window_extent(renderer) for text in names(axes)]
            assert boxes
            inside = axes.get_window_extent(renderer)
            assert all(inside.x0 <= box.x0 and box.x1 <= inside.x1 for box in boxes)
            assert all(inside.y0 <= box.y0 and box.y1 <= inside.y1 for box in boxes)
            assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
            for line in axes.lines:
                if line.get_marker() not in (None, "None", ""):
                    reach = line.get_markersize() / 2 * figure.dpi / 72 * 0.8  # the corners of a round mark are empty
                    for x, y in axes.transData.transform(line.get_xydata()):
                        closest = [(np.clip(x, box.x0, box.x1), np.clip(y, box.y0, box.y1)) for box in boxes]
                        assert all(math.hypot(x - right, y - up) >= reach for right, up in closest)


def test_the_legend_stands_above_the_data_and_letters_are_of_eight_pixels_on_a_telephone() -> None:
    figure = chart_figure([Panel(name, make(), 0.02) for name, make in SETS.items()])
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    (legend,) = figure.legends
    box = legend.get_window_extent(renderer)
    assert box.y0 > max(axes.get_tightbbox(renderer).y1 for axes in figure.axes)
    assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
    for axes in figure.axes:
        around = axes.get_tightbbox(renderer)
        assert around.x0 >= 0 and around.x1 <= figure.bbox.x1
    texts = [*legend.get_texts(), *(text for axes in figure.axes for text in names(axes))]
    assert min(text.get_fontsize() for text in texts) * PHONE / (72 * WIDTH) >= 7.99


def test_what_takes_no_time_stands_at_the_left_edge_and_the_front_is_the_lower_left_hull() -> None:
    marks = crowded()
    axes = details_figure(marks, BANDS, {"front": "front"}, {}).axes[0]
    first = min(each.seconds for each in marks if each.group not in ASIDE)
    low, _ = axes.get_xlim()
    assert first / 10 < low < first
    drawn = [line for line in axes.lines if line.get_marker() in "+^"]
    assert len(drawn) == sum(each.group in ASIDE for each in marks) == 4
    assert all(low < line.get_xdata()[0] < first for line in drawn)
    (front,) = [line for line in axes.lines if len(line.get_xdata()) > 2]
    x, y = front.get_data()
    assert (np.diff(x) >= 0).all() and (np.diff(y) <= 0).all()
    assert not any(
        each.seconds < x[index] and each.errors["front"] < y[index]
        for each in marks
        if math.isfinite(each.errors["map"]) and each.group not in ASIDE
        for index in range(2, len(x) - 1, 2)
    )


def test_crossings_are_those_of_linear_equations() -> None:
    generator = np.random.default_rng(0)
    lines, others = generator.random((2, 30, 2, 2))
    low = generator.random((30, 2))
    boxes = np.concatenate([low, low + 0.2 * generator.random((30, 2)) + 0.05], axis=1)

    def cross(one: Any, other: Any) -> bool:
        along = np.linalg.solve(np.stack([one[1] - one[0], other[0] - other[1]], axis=1), other[0] - one[0])
        return bool(((along > 0) & (along < 1)).all())

    crossed, hit = _crossed(lines, others), _hit(lines, boxes)
    assert 50 < crossed.sum() < 850 and 50 < hit.sum() < 850
    for line, crosses, hits in zip(lines, crossed, hit, strict=True):
        assert crosses.tolist() == [cross(line, other) for other in others]
        for box, through in zip(boxes, hits, strict=True):
            ends = ((line > box[:2]) & (line < box[2:])).all(axis=1).any()
            # A chord of a rectangle crosses one of the diagonals.
            diagonals = box[[0, 1, 2, 3]].reshape(2, 2), box[[0, 3, 2, 1]].reshape(2, 2)
            assert through == (ends or any(cross(line, diagonal) for diagonal in diagonals))
