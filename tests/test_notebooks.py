"""The notebooks as they are kept: stripped, with ids, importing what there is. `make notebooks` runs them."""

from __future__ import annotations

import ast
import importlib
import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def book(request: pytest.FixtureRequest) -> dict[str, Any]:
    return dict(json.loads(request.param.read_text(encoding="utf-8")))


def test_there_are_four() -> None:
    assert [path.stem[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04"]


def test_nothing_is_kept_of_a_run(book: dict[str, Any]) -> None:
    code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    assert all(cell["metadata"] == {} for cell in book["cells"])
    assert book["metadata"]["kernelspec"]["name"] == "python3"


def test_every_cell_has_an_id_of_its_own(book: dict[str, Any]) -> None:
    assert (book["nbformat"], book["nbformat_minor"]) == (4, 5)
    ids = [cell["id"] for cell in book["cells"]]
    assert all(ids) and len(set(ids)) == len(ids)


def test_it_begins_and_ends_with_words(book: dict[str, Any]) -> None:
    first, last = book["cells"][0], book["cells"][-1]
    assert first["cell_type"] == last["cell_type"] == "markdown"
    assert "## Where to go on" in "".join(last["source"])


def test_it_imports_what_there_is(book: dict[str, Any]) -> None:
    code = "\n".join("".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code")
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            for each in node.names:
                assert find_spec(each.name) is not None, each.name
        elif isinstance(node, ast.ImportFrom):
            name = str(node.module)
            if not name.startswith("gns_pl"):
                assert find_spec(name) is not None, name
                continue
            module = importlib.import_module(name)
            for each in node.names:
                assert hasattr(module, each.name) or find_spec(f"{name}.{each.name}") is not None, f"{name}.{each.name}"


def test_links_lead_somewhere(book: dict[str, Any]) -> None:
    text = "\n".join("".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "markdown")
    links = [part.split(")")[0] for part in text.split("](")[1:]]
    assert links
    for link in links:
        assert (NOTEBOOKS[0].parent / link).is_file(), link
