"""Tables in CSV files whose rows are a dataclass: typed when read, whole or not at all when written."""

from __future__ import annotations

import csv
import dataclasses
import io
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from gns_pl.errors import InputError
from gns_pl.io.atomic import write_atomically

R = TypeVar("R")

READERS: dict[type, Callable[[str], Any]] = {bool: lambda text: text == "True", int: int, float: float, str: str}
"""Type of a field → what makes it of a cell."""


def read_table(path: str | Path, kind: type[R], advice: str, *, renamed: Mapping[str, str] | None = None) -> list[R]:
    """Return the rows of a table.

    Columns beyond the fields of the dataclass are left out; a field with a default may have none, as in older tables.

    Args:
        path: the file.
        kind: dataclass of a row, whose fields are bool, int, float or str.
        advice: what is said, behind the path, of a file that holds something else.
        renamed: name of a column in older tables → its name now.

    Raises:
        InputError: no such file, or no such table.
    """
    types = typing.get_type_hints(kind)
    readers = {field.name: READERS[types[field.name]] for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            reader.fieldnames = [(renamed or {}).get(name, name) for name in reader.fieldnames or ()]
            lines = list(reader)
        for field in dataclasses.fields(kind):  # type: ignore[arg-type]
            if field.default is not dataclasses.MISSING and lines and field.name not in lines[0]:
                del readers[field.name]
        return [kind(**{name: parse(line[name]) for name, parse in readers.items()}) for line in lines]
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise InputError(f"{path}: {advice} ({error}).") from error


def render_table(kind: type[Any], rows: Iterable[Any], digits: int | None = None) -> str:
    """Return rows of a dataclass as CSV with a head line.

    Args:
        kind: the dataclass.
        rows: of it.
        digits: significant ones of a float; None writes all of them.
    """
    names, text = [field.name for field in dataclasses.fields(kind)], io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        cells = (getattr(row, name) for name in names)
        writer.writerow([f"{cell:.{digits}g}" if digits and isinstance(cell, float) else cell for cell in cells])
    return text.getvalue()


def write_table(path: str | Path, kind: type[Any], rows: Iterable[Any], digits: int | None = None) -> None:
    """Write a table, whole or not at all; arguments as those of `render_table`.

    Raises:
        StorageError: the disk refuses; a file that was there is as it was.
    """
    write_atomically(Path(path), render_table(kind, rows, digits).encode())
