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


def scene(error: float | None = 0.1, failed: float | None = None, wall: float | None = 2.0, **others) -> dict:
    return {
        "failed_at": failed,
        "errors": {"learned": {"runout_99_error": error}},
        "reference": {"runout_99": 2.0},
        "reference_points": {"all": True},
        "reference_spread": {"cells": [1.5], "runout_99": 0.1},
        "placements": {"number": 0, "failed": 0, "runout_99_error": [], "std": {}},
        "wall_seconds": {"learned": 0.5, "reference": wall},
    } | others


def test_one_sentence_says_what_matters() -> None:
    assert verdict(scene()) == (
        "The final runout of 99 % of the mass is 10.0 % longer than by MPM; MPM itself changes by 5 % on other cells. "
        "A learned run takes 0.5 s; MPM on the cells of the data took 2 s when it was computed."
    )
    assert "3.0 % shorter" in verdict(scene(-0.03)) and "faster" not in verdict(scene())
    assert verdict(scene(failed=0.31)).startswith("The rollout failed after 0.31 s")
    assert "does not advance" in verdict(scene(None))
    assert "than by the stored points of MPM" in verdict(scene(reference_points={"all": False}))
    placed = {"number": 3, "failed": 0, "runout_99_error": [-0.1, -0.2, 0.0], "std": {"runout_99_error": 0.0816}}
    assert verdict(scene(-0.1, placements=placed)).startswith(
        "The final runout of 99 % of the mass is 10.0 % shorter than by MPM in the mean of 3 placements (± 8.2 %, "
        "at most -20.0 %); MPM"
    )
    placed = {"number": 2, "failed": 2, "runout_99_error": [None, None], "std": {}}
    assert "all 2 placements failed" in verdict(scene(None, placements=placed))


def test_a_ratio_of_times_needs_both_measured_for_it() -> None:
    rival = {"cell_size": 0.05, "seconds": 0.25, "error": 0.09, "num_threads": 1}
    speed = {"learned": {"seconds": 0.5, "error": 0.1}, "mpm": [rival], "as_accurate": rival}
    assert verdict(scene(speed=speed)).endswith(
        "Measured warm, in one session: a learned run takes 0.5 s, the cheapest MPM as accurate (cells of 0.05 m, "
        "runout off by 9.0 % against 10.0 %) 0.25 s: 2 times slower."
    )
    assert verdict(scene(speed=speed | {"as_accurate": rival | {"seconds": 1.5}})).endswith("1.5 s: 3 times faster.")
    assert verdict(scene(speed=speed | {"as_accurate": None})).endswith("coarser ones is as accurate.")


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
    # On a phone the label stands above its numbers, so that "learned" and "error" are not off the screen.
    tables = [attributes.get("class") for tag, attributes in tags.seen if tag == "table"]
    assert tables == ["narrow", "narrow", "plain"] and re.search(
        r"max-width: 38rem.*\n.*table\.narrow tr { display: grid", text
    )


def test_several_checkpoints_stand_beside_each_other(checkpoint, tmp_path) -> None:  # noqa: F811
    document = run(checkpoint, tmp_path, only="short")
    hostile = "<script>x</script>"
    path = write_page(
        tmp_path / "two.html", {"a": document, hostile: document}, dict.fromkeys(("a", hostile), Path("x"))
    )
    text = path.read_text(encoding="utf-8")
    assert "<script>" not in text and text.count("&lt;script&gt;") > 2
    assert "compared with the MPM of its own data" in text
