"""Points and what they carry from VTK's XML files, .vtp and .vtu, without VTK.

Read are numbers as text, as base64 and as appended raw or base64 bytes, uncompressed or in zlib's blocks, of either
byte order: all that VTK, ParaView, meshio and gns_pl write by default.
"""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ElementTree
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.limits import LARGEST_RATIO, check_claim, check_memory
from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size

KINDS = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8",
    "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8",
}  # fmt: skip
VERTICES = (1, 2)
"""Types of cells in an UnstructuredGrid that join no points."""
PIECES = {"PolyData": "PolyData/Piece", "UnstructuredGrid": "UnstructuredGrid/Piece"}


@dataclass(frozen=True)
class _Encoding:
    """How a file stores numbers: byte order, type of the lengths, compression, and what is appended."""

    order: str
    length: np.dtype[Any]
    compressed: bool
    appended: bytes
    raw: bool


def read_points(path: Path, *, empty: bool = False) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Return the points of a file [N, 3] and what each carries, name → [N] or [N, C].

    Args:
        path: of the file.
        empty: whether it may have no points, as one of several of a frame.

    Raises:
        InputError: no such file, or one whose numbers do not fit what it claims.
    """
    check_memory(3 * regular_size(path), "the file")
    root, encoding = _parse(path.read_bytes())
    kind = root.get("type", "")
    if kind not in PIECES:
        raise InputError(f"holds {kind or 'something'} and not PolyData or UnstructuredGrid.")
    points: list[NDArray[Any]] = []
    arrays: dict[str, list[NDArray[Any]]] = {}
    for piece in root.findall(PIECES[kind]):
        number = int(piece.get("NumberOfPoints", "0"))
        if number == 0:
            continue
        place = piece.find("Points/DataArray")
        if place is None:
            raise InputError("has points without coordinates.")
        points.append(_numbers(place, number, encoding, components=3))
        for array in piece.findall("PointData/DataArray"):
            if array.get("type") in KINDS:
                arrays.setdefault(array.get("Name", ""), []).append(_numbers(array, number, encoding))
    if not points:
        if empty:
            return np.empty((0, 3)), {}
        raise InputError("has no points.")
    whole = {name: np.concatenate(parts) for name, parts in arrays.items() if len(parts) == len(points)}
    return np.concatenate(points), whole


def has_cells(path: Path) -> bool:
    """Return whether the points of a file are joined by lines, faces or solids, as those of a mesh are."""
    check_memory(3 * regular_size(path), "the file")
    root, encoding = _parse(path.read_bytes())
    for piece in root.iter("Piece"):
        if any(int(piece.get(f"NumberOf{kind}", "0")) > 0 for kind in ("Lines", "Strips", "Polys")):
            return True
        types, number = piece.find("Cells/DataArray[@Name='types']"), int(piece.get("NumberOfCells", "0"))
        if types is not None and number and not np.isin(_numbers(types, number, encoding), VERTICES).all():
            return True
    return False


def parse_xml(text: bytes) -> ElementTree.Element:
    """Return the root of an XML text.

    Raises:
        InputError: no XML, or one that defines entities, by which a small file can become a huge one.
    """
    if b"<!" in text.replace(b"<!--", b""):
        raise InputError("defines entities or a document type, which files of VTK do not.")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError("is not XML, or was cut off.") from error


def _parse(content: bytes) -> tuple[ElementTree.Element, _Encoding]:
    """Return the root of a file without what is appended, and how its numbers are stored."""
    head, tag, rest = content.partition(b"<AppendedData")
    appended, raw = b"", False
    if tag:
        options, _, body = rest.partition(b">")
        raw = b"base64" not in options
        appended = body.partition(b"_")[2]
        head += b"</VTKFile>"
    root = parse_xml(head)
    if root.tag != "VTKFile":
        raise InputError("is XML, but not of VTK.")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    length = KINDS.get(root.get("header_type", "UInt32"), "")
    compressor = root.get("compressor", "")
    if length not in ("u4", "u8") or compressor not in ("", "vtkZLibDataCompressor"):
        raise InputError(f"is compressed by {compressor or 'something'}; write it uncompressed, or with zlib.")
    return root, _Encoding(order, np.dtype(order + length), bool(compressor), appended, raw)


def _numbers(
    array: ElementTree.Element, number: int, encoding: _Encoding, components: int | None = None
) -> NDArray[Any]:
    """Return the numbers of a DataArray [N] or [N, C]."""
    name = array.get("Name") or "an array"
    width = int(array.get("NumberOfComponents", "1"))
    if array.get("type") not in KINDS or width < 1 or (components is not None and width != components):
        raise InputError(f"{name} has {width} components of type {array.get('type')}.")
    kind = np.dtype(encoding.order + KINDS[str(array.get("type"))])
    form = array.get("format")
    if form == "ascii":
        values = np.array((array.text or "").split(), dtype=kind.newbyteorder("="))
    else:
        needed = number * width * kind.itemsize
        if form == "appended":
            offset = int(array.get("offset", "0"))
            if not 0 <= offset <= len(encoding.appended):
                raise InputError(f"{name} lies behind the end of the file.")
            content, as_text = encoding.appended[offset:], not encoding.raw
        else:
            content, as_text = (array.text or "").strip().encode("ascii"), True
        values = np.frombuffer(_unpacked(content, needed, encoding, as_text, name), dtype=kind)
    if len(values) != number * width:
        raise InputError(f"{name} has {len(values)} numbers for {number} points.")
    values = values.astype(kind.newbyteorder("="), copy=False)
    return values if width == 1 else values.reshape(number, width)


def _unpacked(content: bytes, needed: int, encoding: _Encoding, as_text: bool, name: str) -> bytes:
    """Return the bytes of an array of which `needed` are wanted."""
    size = encoding.length.itemsize
    check_claim(needed, len(content), name, ratio=LARGEST_RATIO)
    if not encoding.compressed:
        whole = _decoded(content, size + needed) if as_text else content[: size + needed]
        return whole[size:]
    count = int(_lengths(content, 1, encoding, as_text)[0])
    check_claim(count * size, len(content), name)
    lengths = _lengths(content, 3 + count, encoding, as_text)
    packed = [int(each) for each in lengths[3:]]
    check_claim(sum(packed), len(content), name)
    skipped = _text_length(3 * size + count * size) if as_text else 3 * size + count * size
    rest = content[skipped:]
    blocks = _decoded(rest, sum(packed)) if as_text else rest
    made, place = [], 0
    for length in packed:
        unpacker = zlib.decompressobj()
        made.append(unpacker.decompress(blocks[place : place + length], needed + 1))
        place += length
    return b"".join(made)


def _lengths(content: bytes, number: int, encoding: _Encoding, as_text: bool) -> NDArray[Any]:
    size = number * encoding.length.itemsize
    return np.frombuffer(_decoded(content, size) if as_text else content[:size], dtype=encoding.length, count=number)


def _text_length(number: int) -> int:
    """Return how many characters of base64 so many bytes take, padding among them."""
    return -(-number // 3) * 4


def _decoded(content: bytes, number: int) -> bytes:
    return base64.b64decode(content[: _text_length(number)], validate=True)[:number]
