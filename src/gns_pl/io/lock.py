"""One process at a time in a folder; the lock goes with its process, however that ends."""

from __future__ import annotations

import errno
import fcntl
import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gns_pl.io import StorageError


@contextmanager
def locked(path: str | Path, on_wait: Callable[[], None] | None = None) -> Iterator[bool]:
    """Hold an exclusive lock on the file `path`, made if needed; wait if another process holds it.

    Args:
        path: the lock file; it stays there, and means nothing by itself.
        on_wait: called once if there is something to wait for.

    Yields:
        Whether the lock is held: not where the file system has no locks. What another process may be writing is then
        to be left alone.

    Raises:
        StorageError: the file cannot be made.
    """
    descriptor = open_lock(path)
    try:
        try:
            held = claim(descriptor, path, wait=False)
        except BlockingIOError:
            if on_wait is not None:
                on_wait()
            held = claim(descriptor, path, wait=True)
        yield held
    finally:
        os.close(descriptor)


def open_lock(path: str | Path) -> int:
    """Return a descriptor of the lock file `path`, made if needed; closing it gives up the lock.

    Raises:
        StorageError: the file cannot be made.
    """
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise StorageError(f"{path}: cannot be written ({error.strerror}).") from error


def claim(descriptor: int, path: str | Path, *, wait: bool, inherited: bool = True) -> bool:
    """Lock an open file, and return whether that worked; where the file system has no locks, say so and go on.

    Args:
        descriptor: of `open_lock`.
        path: of the file.
        wait: until no other process holds the lock.
        inherited: by child processes, which then hold it too, also after a `kill -9` of their parent.

    Raises:
        BlockingIOError: another process holds it, and this one is not to wait.
    """
    operation = fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB
    try:
        (fcntl.flock if inherited else fcntl.lockf)(descriptor, operation)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            raise BlockingIOError(error.errno, error.strerror) from error
        _say_no_locks(str(Path(path).parent), error.strerror)
        return False
    return True


@functools.cache
def _say_no_locks(folder: str, reason: str) -> None:
    """Say it once per folder: a cache takes a lock per file."""
    print(f"{folder}: its file system has no locks ({reason}); let one process at a time write there.", file=sys.stderr)
