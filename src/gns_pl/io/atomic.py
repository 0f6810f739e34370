"""A file appears whole or not at all, also under `kill -9`, a full disk or a power cut."""

from __future__ import annotations

import errno
import math
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gns_pl.errors import InputError

TEMPORARY_SUFFIX = ".part"

CANNOT_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EBADF, errno.EISDIR, errno.EACCES}
"""What a file system says that has no such thing as syncing this file or folder: network shares, FUSE, a folder into
which one may write without listing it. None of them says that content was lost, as EIO, ENOSPC and EDQUOT do."""


class StorageError(InputError):
    """The disk refused to take a file: full, read-only or failing. Trying the next file would not help."""


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that becomes `path` when the block ends well, and is removed otherwise.

    The content is on the disk before the name is, and the name is on the disk before this returns.

    Raises:
        StorageError: the operating system refused; `path` is as it was.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}{TEMPORARY_SUFFIX}")
    try:
        yield temporary
        sync(temporary)
        temporary.replace(path)
        sync(path.parent)
    except OSError as error:
        raise StorageError(f"{path}: cannot be written ({error.strerror or error}).") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: str | Path, content: bytes | memoryview) -> None:
    """Write `content` to `path`, whole or not at all.

    Raises:
        StorageError: the operating system refused; `path` is as it was.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def remove_temporary_files(directory: str | Path, name: str = "*") -> None:
    """Remove what killed writers of `name` left in `directory`; only for whoever is alone in writing there."""
    for leftover in Path(directory).glob(f".{name}.*{TEMPORARY_SUFFIX}"):
        leftover.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk when this returns, where the file system can do that.

    Raises:
        OSError: the content did not reach the disk.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in CANNOT_SYNC:
            raise


def free_bytes(folder: str | Path) -> float:
    """Return the room that is left on the disk of a folder [bytes]; infinite where the file system does not know it."""
    try:
        usage = shutil.disk_usage(folder)
    except OSError:
        return math.inf
    return usage.free if usage.free or usage.total else math.inf
