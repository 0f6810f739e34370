"""TFRecord files and the protocol buffers in them, as far as a `SequenceExample` needs: read without TensorFlow.

A record is its length in eight bytes, the masked CRC-32C of these in four, the content, and its masked CRC in four.

| equation | code |
|---|---|
| CRC-32C: reflected, polynomial 1EDC6F41, all ones before and after | `crc32c` |
| mask(c) = ((c >> 15) | (c << 17)) + A282EAD8, modulo 2³² | `masked` |
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.limits import check_memory
from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size
from gns_pl.machine import compile_function

_POLYNOMIAL = 0x82F63B78  # 1EDC6F41 with its bits reversed
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


@functools.cache
def _compiled() -> tuple[Callable[..., int], NDArray[np.uint32]]:
    """Return the loop over bytes and its table; compiled when first needed."""
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(_POLYNOMIAL), table >> 1).astype(np.uint32)

    def loop(content: NDArray[np.uint8], table: NDArray[np.uint32]) -> int:
        value = np.uint32(0xFFFFFFFF)
        for byte in content:
            value = table[(value ^ byte) & np.uint32(0xFF)] ^ (value >> np.uint32(8))
        return int(value ^ np.uint32(0xFFFFFFFF))

    return compile_function(loop), table


def crc32c(content: bytes | memoryview) -> int:
    """Return the CRC-32C (Castagnoli) of bytes."""
    loop, table = _compiled()
    return int(loop(np.frombuffer(content, dtype=np.uint8), table))


def masked(value: int) -> int:
    """Return a CRC as TFRecord stores it, rotated and shifted, so that the CRC of what holds CRCs is none of them."""
    return ((value >> 15 | value << 17) + 0xA282EAD8) & 0xFFFFFFFF


def record_places(path: Path) -> list[tuple[int, int]]:
    """Return the first byte and the length of every record's content; the lengths' checksums are checked.

    Raises:
        InputError: no TFRecord file, or one that is cut off.
    """
    size, offset = regular_size(path), 0
    places: list[tuple[int, int]] = []
    with path.open("rb") as file:
        while offset < size:
            file.seek(offset)
            head = file.read(12)
            if len(head) < 12:
                raise InputError(f"is cut off in the head of record {len(places)}.")
            length, check = struct.unpack("<QI", head)
            if masked(crc32c(head[:8])) != check:
                raise InputError(
                    f"is no TFRecord file, or damaged: the length of record {len(places)} has a wrong sum."
                )
            if offset + 16 + length > size:
                raise InputError(f"is cut off: record {len(places)} claims {length:,} bytes.")
            places.append((offset + 12, length))
            offset += 16 + length
    return places


def read_record(path: Path, place: tuple[int, int]) -> memoryview:
    """Return the content of a record, its checksum checked.

    Raises:
        InputError: another checksum.
    """
    offset, length = place
    check_memory(3 * length, "a record")
    with path.open("rb") as file:
        file.seek(offset)
        content = file.read(length)
        check = file.read(4)
    if len(content) < length or len(check) < 4 or masked(crc32c(content)) != int.from_bytes(check, "little"):
        raise InputError("its content has a wrong checksum; the file is damaged.")
    return memoryview(content)


def _varint(message: memoryview, offset: int) -> tuple[int, int]:
    """Return a number of seven bits a byte, and the place behind it."""
    value = 0
    for count in range(10):
        if offset + count >= len(message):
            break
        byte = message[offset + count]
        value |= (byte & 0x7F) << 7 * count
        if byte < 0x80:
            return value, offset + count + 1
    raise InputError("a protocol buffer in it is damaged.")


def fields(message: memoryview) -> Iterator[tuple[int, Any]]:
    """Yield the number and value of every field of a message: bytes as a view, a varint as a number.

    Raises:
        InputError: no protocol buffer.
    """
    offset = 0
    while offset < len(message):
        key, offset = _varint(message, offset)
        number, wire = key >> 3, key & 7
        if wire == _VARINT:
            value, offset = _varint(message, offset)
            yield number, value
            continue
        length = {_FIXED64: 8, _FIXED32: 4}.get(wire)
        if wire == _BYTES:
            length, offset = _varint(message, offset)
        if length is None or offset + length > len(message):
            raise InputError("a protocol buffer in it is damaged.")
        yield number, message[offset : offset + length]
        offset += length


def _one(message: memoryview, wanted: int) -> list[Any]:
    return [value for number, value in fields(message) if number == wanted and isinstance(value, memoryview)]


def entries(message: memoryview) -> Iterator[tuple[str, memoryview]]:
    """Yield the names and values of a map from text to messages, as the first field of `Features`, `FeatureLists`."""
    for entry in _one(message, 1):
        parts = dict(fields(entry))
        name, value = parts.get(1), parts.get(2)
        if isinstance(name, memoryview) and isinstance(value, memoryview):
            yield bytes(name).decode("utf-8", errors="replace"), value


def byte_values(feature: memoryview) -> list[memoryview]:
    """Return the values of a `Feature` that holds a list of bytes; none if it holds numbers."""
    return [value for bytes_list in _one(feature, 1) for value in _one(bytes_list, 1)]


def sequence_example(message: memoryview) -> tuple[dict[str, list[memoryview]], dict[str, list[memoryview]]]:
    """Return the byte values of a `SequenceExample`: name → values of its context, and name → one a step.

    Raises:
        InputError: no such message, or a step that does not hold exactly one value.
    """
    context = {name: byte_values(feature) for part in _one(message, 1) for name, feature in entries(part)}
    lists: dict[str, list[memoryview]] = {}
    for part in _one(message, 2):
        for name, feature_list in entries(part):
            steps = [byte_values(feature) for feature in _one(feature_list, 1)]
            if any(len(step) != 1 for step in steps):
                raise InputError(f"{name[:40]} must hold one value a step.")
            lists[name] = [step[0] for step in steps]
    return context, lists
