"""The worked example over two steps: every way leaves its row, and the page and the figure come from the tables."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

from gns_pl.models.checkpoint import load_checkpoint

ROOT = Path(__file__).parents[2]


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    module = importlib.import_module("inverse")
    monkeypatch.setattr(module, "STEPS", 2)
    monkeypatch.setattr(module, "FINE", 1 / 24)
    monkeypatch.setattr(module, "COARSE", 1 / 16)
    monkeypatch.setattr(module, "HORIZONS", (1, 2))
    monkeypatch.setattr(module, "WALK", 12)
    return module


def test_it_runs_and_tells(example: ModuleType, tmp_path: Path) -> None:
    checkpoint = load_checkpoint("friction_plane")
    [truth] = example.truths(1)
    page = importlib.import_module("inverse_page")
    rows = list(example.fits(checkpoint, 0, truth, list(page.METHODS)))
    assert [row["method"] for row in rows] == list(page.METHODS)
    assert all(20 <= float(row["found_angle_deg"]) <= 45 and abs(float(row["found_speed"])) <= 1.5 for row in rows)
    assert all(abs(float(row["found_speed"]) - truth[1]) < 0.3 for row in rows)  # two steps tell the velocity
    observed = example.deposit_of_mpm(checkpoint.data, truth, example.FINE, seed=1000)
    slopes = list(example.agreement(example.problem_of(checkpoint, observed), 0, truth))
    assert [row["steps"] for row in slopes] == [1, 2] and all(float(row["to_narrow"]) < 1e-3 for row in slopes)
    example.write_rows(tmp_path / "inverse.csv", rows)
    example.write_rows(tmp_path / "inverse_gradients.csv", slopes)
    page.write_figure(tmp_path)
    page.write_page(tmp_path)
    assert (tmp_path / "inverse.png").stat().st_size > 1e4
    assert "Who wins" in (tmp_path / "inverse.md").read_text(encoding="utf-8")


def test_the_page_is_that_of_the_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    for name in ("inverse.csv", "inverse_gradients.csv"):
        (tmp_path / name).write_bytes((ROOT / "docs" / name).read_bytes())
    importlib.import_module("inverse_page").write_page(tmp_path)
    assert (tmp_path / "inverse.md").read_bytes() == (ROOT / "docs" / "inverse.md").read_bytes()
