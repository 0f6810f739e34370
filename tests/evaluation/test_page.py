"""The page: one file, all scenes and checkpoints, every figure in it, and nothing from elsewhere."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from gns_pl.evaluation.page import verdict, write_page
from tests.evaluation.test_evaluate import checkpoint, one_thread, references, run  # noqa: F401


class Tags(HTMLParser):
    """Collects what a page opens, and whether it closes it."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attributes)))
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def scene(error: float | None = 0.1, failed: float | None = None, wall: float | None = 2.0) -> dict:
    return {
        "failed_at": failed,
        "errors": {"learned": {"runout_99_error": error}},
        "reference": {"runout_99": 2.0},
        "reference_spread": {"cells": [1.5], "runout_99": 0.1},
        "wall_seconds": {"learned": 0.5, "reference": wall},
    }


def test_one_sentence_says_what_matters() -> None:
    assert verdict(scene()) == (
        "The final runout of 99 % of the mass is 10.0 % longer than by MPM, which itself changes by 5 % on other "
        "cells; 0.5 s instead of 2 s, 4 times faster."
    )
    assert "3.0 % shorter" in verdict(scene(-0.03)) and "2 times slower" in verdict(scene(wall=0.25))
    assert verdict(scene(failed=0.31)).startswith("The rollout failed after 0.31 s")
    assert "does not advance" in verdict(scene(None))


def test_a_page_needs_no_other_file(checkpoint, tmp_path) -> None:  # noqa: F811
    document = run(checkpoint, tmp_path, figures=True)
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    sources = [attributes["src"] for tag, attributes in tags.seen if tag == "img"]
    assert len(sources) == 2 + 2 * 2 and all(source.startswith("data:image/") for source in sources)
    assert not re.search(r"https?://", text) and "None" not in text and "nan" not in text.lower().split()
    ids = {attributes["id"] for _, attributes in tags.seen if "id" in attributes}
    links = {attributes["href"][1:] for tag, attributes in tags.seen if tag == "a"}
    assert links <= ids and {"short", "tall", "provenance"} <= ids
    assert document["run"]["machine"] in text and "evaluation" in text


def test_several_checkpoints_stand_beside_each_other(checkpoint, tmp_path) -> None:  # noqa: F811
    document = run(checkpoint, tmp_path, only="short")
    hostile = "<script>x</script>"
    path = write_page(
        tmp_path / "two.html", {"a": document, hostile: document}, dict.fromkeys(("a", hostile), Path("x"))
    )
    text = path.read_text(encoding="utf-8")
    assert "<script>" not in text and text.count("&lt;script&gt;") > 2
    assert "compared with the MPM of its own data" in text
