"""Which deck each CB-Geo run was made by: the nearest one, in its own folder or in one over it."""

from __future__ import annotations

import functools
import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path

from gns_pl.convert.formats.cb_geo_runs import Run
from gns_pl.convert.formats.deck import Deck, read_deck
from gns_pl.convert.formats.metadata import read_json
from gns_pl.convert.formats.series import listed
from gns_pl.errors import InputError
from gns_pl.text import override

ABOVE = 3
"""Folders over a run in which decks are looked for, even over the source."""


def decks_of(runs: Sequence[Run], root: Path, deck: Path | None) -> tuple[list[Deck], list[str]]:
    """Return the deck of every run, an empty one where there is none, and sentences for the report.

    Args:
        runs: of a source.
        root: the source; all folders from a run up to it are looked through.
        deck: named by the user, for all of them.

    Raises:
        InputError: a deck that cannot be used or chosen, or runs without one beside runs that have one.
    """
    if deck is not None:
        notes = [f"{deck} is taken for all {len(runs)} runs, as it was named"] if len(runs) > 1 else []
        return [read_deck(deck)] * len(runs), notes
    candidates = functools.cache(_decks_in)
    read = functools.cache(read_deck)
    paths = [_nearest(run, root, candidates, read) for run in runs]
    _check_lacking(runs, paths, root)
    notes = []
    users: dict[Path, list[str]] = defaultdict(list)
    for run, path in zip(runs, paths, strict=True):
        if path is not None:
            users[path].append(run.name)
    for path, names in users.items():
        if len(names) > 1:
            notes.append(f"{path} is the deck of all of these, there being no other: {listed(names)}")
        elif not path.is_relative_to(_whole(root)):
            notes.append(f"the deck is {path}, over the source")
    if not users:
        notes.append("no JSON deck was found, so time step, box, gravity and material are open; name it: deck=…")
    return [Deck() if path is None else read(path) for path in paths], notes


def _nearest(
    run: Run, root: Path, candidates: Callable[[Path], tuple[Path, ...]], read: Callable[[Path], Deck]
) -> Path | None:
    folder, top = _whole(run.folder), _whole(root)
    for distance, place in enumerate([folder, *folder.parents]):
        if distance > ABOVE and not place.is_relative_to(top):
            break
        decks = candidates(place)
        named = [path for path in decks if _uuid(path) == folder.name]  # CB-Geo calls the folder of a run so
        decks = tuple(named) or decks
        if len(decks) > 1 and any(read(path) != read(decks[0]) for path in decks):
            raise InputError(
                f"{run.folder}: {place} has {len(decks)} different decks for it; say which one: "
                f"{override('deck', decks[0])}"
            )
        if decks:
            return decks[0]
    return None


def _check_lacking(runs: Sequence[Run], paths: Sequence[Path | None], root: Path) -> None:
    """Refuse runs that would get a deck from further up, or none, while others have one of their own below it."""
    own = {path.parent: run.name for run, path in zip(runs, paths, strict=True) if path is not None}
    over = {place: name for folder, name in own.items() for place in folder.parents}
    for run, path in zip(runs, paths, strict=True):
        place = _whole(root) if path is None else path.parent
        if place in over and _whole(run.folder) != place:
            raise InputError(
                f"{run.folder}: has no deck of its own, as {over[place]} has; put its deck beside it, or convert the "
                "runs one by one with deck=…"
            )


def _whole(path: Path) -> Path:
    """Return a path from the root of the file system, without `..`, so that its parents are folders over it."""
    return Path(os.path.normpath(path.absolute()))


def _decks_in(folder: Path) -> tuple[Path, ...]:
    return tuple(path for path in sorted(folder.glob("*.json")) if _is_deck(path))


def _is_deck(path: Path) -> bool:
    try:
        return {"analysis", "mesh"} <= set(read_json(path))
    except InputError:
        return False


def _uuid(path: Path) -> object:
    analysis = read_json(path).get("analysis")
    return analysis.get("uuid") if isinstance(analysis, dict) else None
