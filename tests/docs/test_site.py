"""The site's rules, without MkDocs: every document and every room is on it, and links lead where they should."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest
from matplotlib import font_manager
from PIL import ImageFont

ROOT = Path(__file__).parents[2]


sys.path.insert(0, str(ROOT / "docs/site"))  # as MkDocs does for its hooks
pages = importlib.import_module("pages")
rooms = importlib.import_module("rooms")
architecture = importlib.import_module("architecture")


def in_navigation(entry: object) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [page for part in (entry.values() if isinstance(entry, dict) else entry) for page in in_navigation(part)]


def test_every_document_is_in_the_navigation_once() -> None:
    listed = in_navigation(pages.navigation())
    assert len(listed) == len(set(listed))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= set(listed)
    assert {f"models/{path.name}" for path in (ROOT / "src/gns_pl/pretrained").glob("*.md")} <= set(listed)


def test_every_room_has_an_api_page() -> None:
    here = (ROOT / "src/gns_pl").iterdir()
    there = {path.stem for path in here if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert there - {"__init__"} == set(rooms.ROOMS)
    assert {f"api/{room}.md" for room in rooms.ROOMS} <= set(in_navigation(pages.navigation()))
    for room, modules in rooms.ROOMS.items():
        for module in (room, *(f"{room}.{name}" for name in modules)):
            assert rooms.is_there(f"gns_pl.{module}"), module
            assert f"::: gns_pl.{module}\n" in rooms.api_page(room)


def test_links_of_the_repository_lead_to_pages_of_the_site() -> None:
    text = (
        "[a](docs/training.md#one-step) ![b](docs/trust.png) [c](src/gns_pl/mpm/)\n"
        "[d](src/gns_pl/pretrained/collapse.md) [e](conf/train.yaml) `[f](docs/training.md)`\n"
        "[g](https://example.org/docs/trust.md) [h](nope.md)\n"
        '<img src="docs/trust.png"> <a href="docs/training.md#one-step">i</a>'
    )
    assert pages.relinked(text, "README.md") == (
        "[a](training.md#one-step) ![b](trust.png) [c](api/mpm.md)\n"
        "[d](models/collapse.md) [e](source/conf/train.yaml.md) `[f](docs/training.md)`\n"
        "[g](https://example.org/docs/trust.md) [h](nope.md)\n"
        '<img src="trust.png"> <a href="training.html#one-step">i</a>'
    )
    card = "src/gns_pl/pretrained/collapse.md"
    assert pages.relinked("[a](../../../docs/trust.md)", card) == "[a](../trust.md)"
    assert pages.relinked("[b](../mpm/plan.py)", card) == "[b](../source/src/gns_pl/mpm/plan.py.md)"
    assert pages.relinked("```\n[a](docs/trust.md)\n```\n", "README.md") == "```\n[a](docs/trust.md)\n```\n"


def test_links_written_here_lead_to_files() -> None:
    for origin in pages.documents().values():
        for target in pages.links((ROOT / origin).read_text(encoding="utf-8")):
            path = pages.resolve(target, origin)
            assert path is None or pages.place(path), f"{origin}: {target}"


def test_names_in_code_become_references_and_names_that_are_gone_are_told(caplog: pytest.LogCaptureFixture) -> None:
    classes = rooms.class_identifiers()
    html = "<p><code>Scene</code> <code>gns_pl.mpm.simulate(scene)</code> <code>tan</code> docs/trust.md</p>"
    linked = pages.cross_referenced(html, "api/io.md", classes)
    assert re.findall(r'identifier="([^"]+)"', linked) == ["gns_pl.scene.Scene", "gns_pl.mpm.simulate"]
    assert '<a href="../trust.html">docs/trust.md</a>' in linked
    assert "<code>tan</code>" in linked
    assert not caplog.records
    pages.cross_referenced("<p><code>gns_pl.mpm.simulat</code></p>", "x.md", classes)
    assert "gns_pl.mpm.simulat, which is not there" in caplog.text


def test_exports_that_a_page_lacks_are_told() -> None:
    html = '<h2 id="gns_pl.rollout.rollout"><h2 id="gns_pl.rollout.Run"><h2 id="gns_pl.rollout.unroll.unroll">'
    assert rooms.undocumented(html, "rollout") == ["static_of"]
    assert "mlp" not in rooms.undocumented('<h2 id="gns_pl.nn.mlp.mlp">', "nn")


def test_units_in_docstrings_are_not_references() -> None:
    pytest.importorskip("griffe")
    style = importlib.import_module("docstrings")
    assert style.plain_brackets("position: [N, D] [m], `a[0][1]`") == r"position: [N, D] \[m], `a[0][1]`"
    assert style.plain_brackets("[step][gns_pl.models.simulator]") == "[step][gns_pl.models.simulator]"


def test_contributing_shows_the_floors_of_the_import_contract() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    shown = text[text.index("<!-- floors -->\n") : text.index("<!-- /floors -->")].splitlines()[1:]
    table = rooms.floors_table()
    assert shown == table, "\n".join(["CONTRIBUTING.md must hold", *table])
    assert {row.split("`")[1] for row in table[2:]} == set(rooms.ROOMS)


def test_the_picture_of_the_architecture_is_up_to_date() -> None:
    picture = architecture.architecture()
    assert architecture.FILE.read_text(encoding="utf-8") == picture, "python docs/site/architecture.py writes it anew"
    names = re.findall(r'class="room"[^>]*>(\w+)<', picture)
    assert names == [room for _, there in rooms.floors() for room in there]


def test_every_line_of_the_picture_fits_a_telephone() -> None:
    picture = architecture.architecture()
    assert architecture.WIDTH <= 390
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 11.5)  # the widest of those it asks for
    texts = re.findall(r'<text x="(\d+)"[^>]*>([^<]+)<', picture)
    assert len(texts) > len(rooms.ROOMS)
    assert max(int(left) + font.getlength(text) for left, text in texts) < architecture.WIDTH - architecture.MARGIN
