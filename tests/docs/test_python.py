"""The README's Python runs as it stands there, MPM on coarser cells."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gns_pl.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_it_runs(block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(compile(block.replace("1 / 24", "1 / 6"), "README.md", "exec"), names)
    flow = names["flow"]
    assert isinstance(flow, Trajectory) and flow.num_frames > 50


def test_there_are_two_of_them() -> None:
    assert len(BLOCKS) == 2
