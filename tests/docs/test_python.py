"""The Python of the README and of docs/python.md runs as it stands there, MPM on coarser cells."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gns_pl.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
PAGES = {"README.md": 1, "docs/python.md": 5}
"""Page → blocks of Python."""


def blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_it_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks(page):
        exec(compile(block.replace("1 / 24", "1 / 6"), page, "exec"), names)
    for name in {"flow", "truth", "slope"} & set(names):
        trajectory = names[name]
        assert isinstance(trajectory, Trajectory) and trajectory.num_frames > 50


def test_no_block_is_left_out() -> None:
    assert {page: len(blocks(page)) for page in PAGES} == PAGES


def test_python_stands_in_the_first_screen_of_a_short_readme() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 130 and lines.index("```python") < 30
