"""Figures of the stress suite: a panel for each axis, and a line for each model where it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from gns_pl.viz.survival import plot_survival

STEPS = (np.array([0.0, 2.0, 6.0]), np.array([1.0, 0.5, 0.25]))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are saved."""
    figures: list[Figure] = []
    saved = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *args, **kwargs: (figures.append(self), saved(self, *args))[1])
    return figures


@pytest.mark.parametrize(("number", "grid"), [(1, (1, 1)), (4, (1, 4)), (6, (2, 4))])
def test_every_axis_has_a_panel(tmp_path: Path, drawn: list[Figure], number: int, grid: tuple[int, int]) -> None:
    curves = {"learned": {f"axis_{index}": STEPS for index in range(number)}}
    plot_survival(curves, [tmp_path / "s.png", tmp_path / "s.svg"])
    assert all((tmp_path / f"s.{ending}").stat().st_size > 1000 for ending in ("png", "svg"))
    axes = drawn[0].axes
    assert len(axes) == grid[0] * grid[1]
    assert [panel.get_title() for panel in axes if panel.get_visible()] == [f"axis {i}" for i in range(number)]


def test_a_run_survives_until_it_fails(tmp_path: Path, drawn: list[Figure]) -> None:
    """The line steps down at the time of a failure, not before it, and curves of one share are told apart."""
    plot_survival({"a": {"speed": STEPS}, "b": {"speed": STEPS, "size": STEPS}}, [tmp_path / "s.png"])
    speed, size = drawn[0].axes
    first, second = speed.lines
    assert [line.get_label() for line in speed.lines] == ["a", "b"] and [line.get_label() for line in size.lines] == [
        "b"
    ]
    assert first.get_drawstyle() == second.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(first.get_ydata(), STEPS[1])
    assert 0 < (np.asarray(second.get_ydata()) - STEPS[1]).max() < 0.05
    assert speed.get_ylim()[1] > 1.0 and speed.get_xlim()[0] == 0
    assert len({(line.get_color(), line.get_linestyle()) for line in speed.lines}) == 2


def test_nine_models_have_nine_looks(tmp_path: Path, drawn: list[Figure]) -> None:
    plot_survival({f"model {index}": {"speed": STEPS} for index in range(9)}, [tmp_path / "s.png"])
    lines = drawn[0].axes[0].lines
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 9


def test_the_legend_names_every_model_once_wherever_it_ran(tmp_path: Path, drawn: list[Figure]) -> None:
    plot_survival({"a": {"size": STEPS}, "b": {"speed": STEPS, "size": STEPS}}, [tmp_path / "s.png"])
    [legend] = drawn[0].legends
    assert sorted(text.get_text() for text in legend.get_texts()) == ["a", "b"]
    plot_survival({"b": {"speed": STEPS}, "a": {"size": STEPS}}, [tmp_path / "s.png"])
    [legend] = drawn[1].legends
    assert [text.get_text() for text in legend.get_texts()] == ["b", "a"]
