"""Files stay of a size that can be read at once."""

from __future__ import annotations

import importlib
import statistics
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs/site"))
rooms = importlib.import_module("rooms")

LINES = {
    str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
    for path in sorted((ROOT / "src/gns_pl").rglob("*.py"))
}


def test_no_file_is_longer_than_320_lines() -> None:
    assert {path: lines for path, lines in LINES.items() if lines > 320} == {}, "part them by what they are about"


def test_half_of_the_files_are_no_longer_than_150_lines() -> None:
    assert statistics.median(LINES.values()) <= 150


def test_lines_are_counted_by_room(tmp_path: Path) -> None:
    source, tests = tmp_path / "src/gns_pl", tmp_path / "tests"
    for path, lines in ((source / "io/a.py", 3), (source / "io/deep/b.py", 4), (source / "text.py", 5)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("1\n" * lines)
    (source / "io/notes.md").write_text("no code\n")
    for path, lines in ((tests / "io/test_a.py", 6), (tests / "test_text.py", 7), (tests / "conftest.py", 1)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("1\n" * lines)
    assert rooms.lines_by_room(source) == {"io": 7, "text": 5}
    table = rooms.lines_table([tmp_path])
    assert table[2:] == ["| io | 7 + 6 |", "| text | 5 + 7 |", "| all | 12 + 14 |"]
