"""Blocks of code of docs/extend.md, which the tests here do as they are written there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def blocks(heading: str, language: str = "python") -> list[str]:
    """Return the blocks of code of a language below a heading."""
    page = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    return re.findall(rf"^```{language}\n(.*?)^```", section, re.DOTALL | re.MULTILINE)
