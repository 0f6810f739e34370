"""NumPy's own file format: header and numbers, alone in a file (.npy) or in a zip (.npz). No pickle is opened here."""

from __future__ import annotations

import ast
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.limits import LARGEST_RATIO, check_claim, check_memory
from gns_pl.convert.formats.pickled import checked_shape
from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size

MAGIC = b"\x93NUMPY"
MOST_HEADER = 10_000
"""Bytes of a header; those of real files have some hundred."""


@dataclass(frozen=True)
class ArrayHeader:
    """What an array says of itself.

    Attributes:
        dtype: of the numbers.
        shape: its lengths.
        fortran: the first index runs fastest.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran: bool

    @property
    def num_bytes(self) -> int:
        """Of all its numbers."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_array_header(stream: IO[bytes]) -> ArrayHeader:
    """Read the header of an array; the stream then stands at its content.

    Raises:
        InputError: no array of NumPy's, or a header that is damaged.
    """
    start = stream.read(8)
    if len(start) < 8 or not start.startswith(MAGIC):
        raise InputError("is not an array in NumPy's format.")
    if start[6] not in (1, 2, 3):
        raise InputError(f"is in version {start[6]} of NumPy's format, which is not known.")
    length = int.from_bytes(stream.read(2 if start[6] == 1 else 4), "little")
    if length > MOST_HEADER:
        raise InputError(f"has a header of {length:,} bytes; it is damaged or made to harm.")
    text = stream.read(length)
    if len(text) < length:
        raise InputError("is cut off in its header.")
    try:
        header = ast.literal_eval(text.decode("utf-8" if start[6] == 3 else "latin1").strip())
        if not isinstance(header, dict) or set(header) != {"descr", "fortran_order", "shape"}:
            raise ValueError
        dtype = np.lib.format.descr_to_dtype(header["descr"])
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError, KeyError, IndexError) as error:
        raise InputError("has a damaged header.") from error
    return ArrayHeader(dtype, checked_shape(header["shape"]), bool(header["fortran_order"]))


def read_numbers(stream: IO[bytes], header: ArrayHeader, stored: int, what: str) -> NDArray[Any]:
    """Read the content behind a header of numbers.

    Args:
        stream: at the content.
        header: of the array.
        stored: bytes of the content that there are.
        what: names it in messages.

    Raises:
        InputError: more is claimed than stored or than fits into memory, or the array holds objects.
    """
    if header.dtype.hasobject:
        raise InputError(f"{what} holds Python objects.")
    check_claim(header.num_bytes, stored, what)
    check_memory(2 * header.num_bytes, what)
    content = stream.read(header.num_bytes)
    if len(content) < header.num_bytes:
        raise InputError(f"{what} is cut off.")
    flat = np.frombuffer(content, dtype=header.dtype)
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


@contextmanager
def open_member(archive: zipfile.ZipFile, name: str) -> Iterator[tuple[IO[bytes], ArrayHeader, int]]:
    """Yield a member of an .npz at its content, its header, and how many bytes follow.

    Raises:
        InputError: it claims to unpack to more than any compression gives.
    """
    info = archive.getinfo(name)
    check_claim(info.file_size, info.compress_size, name, ratio=LARGEST_RATIO)
    with archive.open(info) as stream:
        header = read_array_header(stream)
        yield stream, header, info.file_size - stream.tell()


def members(path: Path) -> dict[str, str]:
    """Return the name of every array of an .npz → that of its member."""
    regular_size(path)
    with zipfile.ZipFile(path) as archive:
        return {name.removesuffix(".npy"): name for name in archive.namelist() if name.endswith(".npy")}


def map_numbers(path: Path) -> NDArray[Any]:
    """Return an .npy file as an array that stays on the disk.

    Raises:
        InputError: it holds objects, or less than it claims.
    """
    size = regular_size(path)
    with path.open("rb") as file:
        header = read_array_header(file)
        offset = file.tell()
    if header.dtype.hasobject:
        raise InputError(
            "holds pickled Python objects, and to open these runs whatever code stands in them; save the positions as "
            "plain numbers [T, N, D]."
        )
    check_claim(header.num_bytes, size - offset, "its header")
    order: Any = "F" if header.fortran else "C"
    if header.num_bytes == 0:
        raise InputError("is empty.")
    return np.memmap(path, dtype=header.dtype, mode="r", offset=offset, shape=header.shape, order=order)
