"""`convert`: a foreign source becomes a folder in another format, there whole or not at all, gone on with after a kill.

All is written into a hidden folder beside the target, which takes the target's name when it is finished. A source that
cannot be used leaves nothing behind; a kill or a full disk leaves the hidden folder, and the same command goes on in
it: where it was for our format, from the beginning for others.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.convert import exports
from gns_pl.convert.facts import Facts, work_out
from gns_pl.convert.formats import ForeignSet
from gns_pl.convert.given import Given
from gns_pl.convert.plan import Item, plan_items
from gns_pl.convert.recordings import Assumed
from gns_pl.convert.sets import write_set
from gns_pl.errors import InputError
from gns_pl.io import StorageError, remove_temporary_files
from gns_pl.io.atomic import sync, write_atomically
from gns_pl.io.lock import locked

BEGUN = "conversion.json"
LOCK = ".lock"


def convert(
    source: ForeignSet,
    target: str | Path,
    *,
    to: str = "gns_pl",
    given: Given,
    assumed: Assumed,
    name: str | None = None,
    valid: int = 1,
    test: int = 1,
) -> Path:
    """Write a foreign set in another format.

    Args:
        source: the source, from `open_set`.
        target: folder; must not be there yet.
        to: "gns_pl", or a format of `exports.WRITERS`.
        given: what the user says of units and axes.
        assumed: what stands in scenes where the source does not say.
        name: of a data set of ours; the target's name if None.
        valid: trajectories to hold out where the source has no splits.
        test: the same for tests.

    Returns:
        The target.

    Raises:
        InputError: a source or settings that cannot be used; nothing is left behind.
        StorageError: the disk refuses; what is written stays, and the same command goes on.
    """
    known = ("gns_pl", *exports.WRITERS)
    if to not in known:
        raise InputError(f"to must be one of {', '.join(known)}, not {to!r}.")
    target = Path(target)
    items = plan_items(source.names, valid=valid, test=test)
    facts = work_out(source, given)
    begun = _identity(source, target, to, facts, assumed, items)
    if target.exists():
        raise InputError(f"{target}: exists already; remove it or choose another target=.")
    part, warning = target.with_name(f".{target.name}.converting"), None
    with _made(part, begun), _progress(len(items), str(target)) as on_done:
        if to == "gns_pl":
            write_set(part, source, items, facts, assumed, name=name or target.name, on_done=on_done)
        else:
            _clear(part)
            writer, common = exports.WRITERS[to][0], exports.WRITERS[to][1]()
            try:
                writer(exports.Export(part, source, items, facts, assumed, common, on_done))
            except OSError as error:
                raise StorageError(f"{part}: cannot be written ({error.strerror or error}).") from error
            warning = common.warning()
        remove_temporary_files(part)
        (part / BEGUN).unlink()
        (part / LOCK).unlink()
        _rename(part, target)
    if warning:
        print(warning)
    return target


def _rename(part: Path, target: Path) -> None:
    try:
        part.rename(target)
        sync(target.parent)
    except OSError as error:
        raise StorageError(f"{target}: cannot be made ({error.strerror}).") from error


def _identity(
    source: ForeignSet, target: Path, to: str, facts: Facts, assumed: Assumed, items: Sequence[Item]
) -> dict[str, Any]:
    """Return what has to be the same for a broken-off conversion to be gone on with."""
    files = (
        [source.path] if source.path.is_file() else sorted(path for path in source.path.rglob("*") if path.is_file())
    )
    if source.path.is_dir() and target.absolute().is_relative_to(source.path.absolute()):
        raise InputError(f"{target}: lies in the source; choose another target=.")
    listed = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    content = {
        "gns_pl": gns_pl.__version__,
        "to": to,
        "files": hashlib.sha256(json.dumps(listed).encode()).hexdigest(),
        "facts": asdict(facts),
        "assumed": asdict(assumed),
        "items": [asdict(item) for item in items],
    }
    plain: dict[str, Any] = json.loads(json.dumps(content))
    return plain


@contextmanager
def _made(part: Path, begun: Mapping[str, Any]) -> Iterator[None]:
    """Have the hidden folder, locked, with what was begun in it; remove it when the source turns out unusable."""
    try:
        part.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{part.parent}: cannot be written ({error.strerror}).") from error
    try:
        with locked(part / LOCK):
            try:
                same = json.loads((part / BEGUN).read_text(encoding="utf-8")) == begun
            except (OSError, ValueError):
                same = False
            if not same:
                _clear(part)
                write_atomically(part / BEGUN, (json.dumps(begun) + "\n").encode())
            yield
    except StorageError:
        raise
    except InputError:
        shutil.rmtree(part, ignore_errors=True)
        raise


def _clear(part: Path) -> None:
    """Remove all but the record and the lock."""
    for path in part.iterdir():
        if path.name in (BEGUN, LOCK):
            continue
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


@contextmanager
def _progress(total: int, what: str) -> Iterator[Callable[[str], None]]:
    """Show a bar on stderr, on a terminal only; yields a function to call when a recording is done."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("trajectories"))
    more = (TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, *more, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total)
        yield lambda source: progress.update(task, advance=1)
