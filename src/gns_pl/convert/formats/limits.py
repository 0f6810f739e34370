"""No size that a foreign file claims is believed: it is compared with what is stored and with the memory there is."""

from __future__ import annotations

import gzip
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size
from gns_pl.machine import free_memory

LARGEST_RATIO = 1100
"""Deflate, zlib and HDF5's gzip never shrink anything by more than 1032 times."""


def unpacked_gzip(path: Path) -> bytes:
    """Return what a .gz file unpacks to.

    Raises:
        InputError: it unpacks to more than is free in memory.
    """
    check_memory(3 * regular_size(path), "the file")
    parts, size = [], 0
    with gzip.open(path) as file:
        while part := file.read(1 << 24):
            parts.append(part)
            size += len(part)
            check_memory(2 * size, "the unpacked file")
    return b"".join(parts)


def check_claim(claimed: int, stored: int, what: str, *, ratio: int = 1) -> None:
    """Raise an `InputError` where a header claims more than its file can hold.

    Args:
        claimed: bytes after unpacking.
        stored: bytes in the file.
        what: the claimant, for the message.
        ratio: by which the file's compression may have shrunk it; 1 for none.
    """
    if claimed < 0 or claimed > stored * ratio:
        raise InputError(
            f"{what} claims {claimed:,} bytes, but only {stored:,} are stored; it is damaged or made to harm."
        )


def check_memory(needed: int, what: str) -> None:
    """Raise an `InputError` where more bytes would have to be in memory at once than are free."""
    free = free_memory()
    if needed > free:
        raise InputError(
            f"{what} needs {needed / 1e9:.3g} GB in memory at once and {free / 1e9:.3g} GB are free; split it, or take "
            "a larger machine."
        )
