"""The rooms of the package for the API pages: which there are, what they export, and what a name in code means.

Sources are read as text, so that nothing has to be installed to know it.

    python docs/site/rooms.py [CHECKOUT …]    # lines of source and of tests by room, of this checkout and of others
"""

from __future__ import annotations

import ast
import functools
import re
import sys
import tomllib
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "src/gns_pl"

# Every room, and the modules of it that users call beside what the room itself exports.
ROOMS: dict[str, tuple[str, ...]] = {
    "commands": (),
    "scene": ("extent",),
    "trajectory": (),
    "io": ("stream", "lock"),
    "metrics": ("measures", "summary", "quantities", "curves", "laws"),
    "mpm": ("settings",),
    "shallow": (),
    "models": ("simulator", "geoelements", "corrector", "registry", "checkpoint", "shipped"),
    "generation": ("kinds",),
    "rollout": ("gradient", "acceleration", "stabilise", "policy", "rest", "failure", "distributed"),
    "solvers": (
        "solver",
        "mpm",
        "learned",
        "corrected",
        "retuned",
        "fitted",
        "fitted_files",
        "fitted_range",
        "hybrid",
        "catalogue",
        "simulate",
        "selection",
        "reduction",
        "ood",
        "training_range",
        "trivial",
    ),
    "evaluation": ("evaluate", "bands", "stress.suite", "chart.benchmark"),
    "viz": (),
    "inverse": ("deposit", "problem", "fit", "search", "solver_fit", "fit_errors", "observed"),
    "training": ("train", "config", "module", "correction", "followed", "sweep", "advice.advise"),
    "data": ("datamodule", "windows", "statistics", "survey"),
    "convert": ("convert", "formats", "weights", "weights_export", "program"),
    "graph": ("context",),
    "nn": ("mlp",),
    "extensions": (),
    "fields": (),
    "errors": (),
    "machine": (),
    "text": (),
    "presets": (),
}


def module_file(name: str) -> Path:
    """Return the file of a module, named from the package down (`rollout.gradient`)."""
    path = PACKAGE.joinpath(*name.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


@functools.cache
def read_module(name: str) -> ast.Module:
    """Return a module's syntax tree."""
    return ast.parse(module_file(name).read_text(encoding="utf-8"))


def exports(module: ast.Module) -> list[str]:
    """Return the names in a module's `__all__`; none if it has no such list."""
    for node in module.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def api_page(room: str) -> str:
    """Return the page of a room: what it exports, then the modules that users call."""
    blocks = [f"---\ntitle: {room}\n---\n\n::: gns_pl.{room}\n    options:\n      heading_level: 1\n"]
    blocks += [f"::: gns_pl.{room}.{module}\n    options:\n      heading_level: 2\n" for module in ROOMS[room]]
    return "\n".join(blocks)


def first_sentence(room: str) -> str:
    """Return the first sentence that a room says of itself."""
    return (ast.get_docstring(read_module(room)) or "").partition("\n\n")[0].replace("\n", " ")


def floors() -> list[tuple[int, list[str]]]:
    """Return every floor's number and rooms, from the import contract in pyproject.toml, the ground floor last."""
    project = tomllib.loads((PACKAGE.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = project["tool"]["importlinter"]["contracts"]
    layers = [layer.split(" | ") for layer in contract["layers"]]
    return list(zip(reversed(range(len(layers))), layers, strict=True))


def floors_table() -> list[str]:
    """Return CONTRIBUTING's table of floors, the ground floor last."""
    rows = ["| floor | room | what it is for |", "|---|---|---|"]
    return rows + [f"| {floor} | `{room}` | {first_sentence(room)} |" for floor, rooms in floors() for room in rooms]


def api_index() -> str:
    """Return the first page of the reference: every room and the first sentence that it says of itself."""
    rows = ["# API", "", ast.get_docstring(read_module("__init__")) or "", "", "| room | |", "|---|---|"]
    for room in ROOMS:
        rows.append(f"| [`gns_pl.{room}`]({room}.md) | {first_sentence(room)} |")
    return "\n".join(rows) + "\n"


@functools.cache
def class_identifiers() -> dict[str, str]:
    """Return the full names of the classes on the API pages by their own, where that is the name of one alone."""
    found: dict[str, set[str]] = {}
    for room, modules in ROOMS.items():
        for module in (room, *(f"{room}.{name}" for name in modules)):
            tree = read_module(module)
            defined = [node.name for node in tree.body if isinstance(node, ast.ClassDef)]
            for name in {*defined, *exports(tree)}:
                if name[0].isupper() and not name.isupper():
                    found.setdefault(name, set()).add(f"gns_pl.{module}.{name}")
    return {name: full.pop() for name, full in found.items() if len(full) == 1}


@functools.cache
def public_names() -> dict[str, str]:
    """Return what the package offers by itself: name → module that defines it."""
    for node in read_module("__init__").body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "PUBLIC":
            return dict(ast.literal_eval(node.value))
    return {}


def identifier(code: str, classes: dict[str, str]) -> str | None:
    """Return the full name of what a piece of code may name: `Scene`, `Simulator.state`, `rollout.gradient`."""
    dotted = code.removeprefix("gns_pl.")
    first, dot, _ = dotted.partition(".")
    if dotted != code and first in public_names():
        module, _, other = public_names()[first].partition(":")  # "module:other" where it is called otherwise there
        return f"gns_pl.{module}.{other + dotted.removeprefix(first) if other else dotted}"
    if dotted != code or (dot and first in ROOMS):
        return f"gns_pl.{dotted}"
    return classes[first] + dotted.removeprefix(first) if first in classes else None


def is_there(full: str) -> bool:
    """Return whether the package has a module, or a module a name at its top, that a full name begins with."""
    parts = full.split(".")[1:]
    depth = 0
    while depth < len(parts) and module_file(".".join(parts[: depth + 1])).is_file():
        depth += 1
    if depth == len(parts):
        return True
    names: set[str] = set()
    for node in read_module(".".join(parts[:depth]) or "__init__").body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        names |= {target.id for target in targets if isinstance(target, ast.Name)}
        names |= {alias.asname or alias.name for alias in getattr(node, "names", [])}
        names |= {getattr(node, "name", "")}
    return parts[depth] in names


def undocumented(html: str, room: str) -> list[str]:
    """Return the names that a room exports and that its page lacks: without a docstring, or named as their module."""
    exported = exports(read_module(room))
    # A function with the name of its module is where that is, if ROOMS has it.
    return [name for name in exported if not re.search(rf'id="gns_pl\.{room}\.(?:{name}\.)?{name}"', html)]


def lines_by_room(folder: Path) -> Counter[str]:
    """Return the lines of Python below a folder, by the first part of the path: of `src/gns_pl` or of `tests`."""
    lines: Counter[str] = Counter()
    for path in folder.rglob("*.py"):
        room = path.relative_to(folder).parts[0].removesuffix(".py").removeprefix("test_")
        lines[room] += len(path.read_text(encoding="utf-8").splitlines())
    return lines


def lines_table(checkouts: list[Path]) -> list[str]:
    """Return a table of lines: a row for each room, and for each checkout its source and, after a +, its tests."""
    counted = [(lines_by_room(path / "src/gns_pl"), lines_by_room(path / "tests")) for path in checkouts]
    rooms = sorted({room for source, _ in counted for room in source})
    head = [f"| room | {' | '.join(path.name for path in checkouts)} |", "|---" * (len(checkouts) + 1) + "|"]
    rows = [(room, [(source[room], tests[room]) for source, tests in counted]) for room in rooms]
    rows.append(("all", [(source.total(), tests.total()) for source, tests in counted]))
    return head + [f"| {room} | {' | '.join(f'{a:,} + {b:,}' for a, b in numbers)} |" for room, numbers in rows]


if __name__ == "__main__":
    print("\n".join(lines_table([PACKAGE.parents[1], *map(Path, sys.argv[1:])])))
