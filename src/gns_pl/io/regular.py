"""Only regular files are opened: a pipe or a device may give bytes for ever, or none and wait."""

from __future__ import annotations

import stat
from pathlib import Path

from gns_pl.errors import InputError


def regular_size(path: Path) -> int:
    """Return the bytes of a regular file; the caller names it in messages. A folder fails when it is opened.

    Raises:
        InputError: a pipe, a device or a socket.
        FileNotFoundError: nothing there.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise InputError("is a pipe or a device, which is not read; put a regular file in its place.")
    return status.st_size


def read_bounded(path: Path, most: int, what: str) -> bytes:
    """Return the content of a small regular file.

    Args:
        path: of the file.
        most: bytes that it may have.
        what: it should be, for the message: "settings".

    Raises:
        InputError: it has more, or is no regular file.
    """
    size = regular_size(path)
    with path.open("rb") as file:
        content = b"" if size > most else file.read(most + 1)  # some files of the system say 0 and give more
    if max(size, len(content)) > most:
        raise InputError(f"has {max(size, len(content)):,} bytes, too many for {what}.")
    return content
