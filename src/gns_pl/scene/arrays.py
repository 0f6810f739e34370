"""Arrays of numbers as text, exact to the bit, so that a scene with a terrain stands in one file."""

from __future__ import annotations

import base64
import binascii
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError

MOST = 1_000_000_000
"""More numbers than this are taken for a damaged file."""


def encoded_array(array: NDArray[np.float64]) -> dict[str, Any]:
    """Return an array as plain values: its shape, and its little-endian float64 numbers by zlib and Base64."""
    packed = zlib.compress(np.ascontiguousarray(array, dtype="<f8").tobytes(), 6)
    return {"shape": list(array.shape), "zlib": base64.b64encode(packed).decode("ascii")}


def decoded_array(owner: str, value: Any) -> Any:
    """Return what `encoded_array` took; lists of numbers, as people write them, stay as they are.

    Args:
        owner: whose array it is, for messages.
        value: from a file.

    Raises:
        InputError: text that is damaged.
    """
    if not isinstance(value, Mapping):
        return value
    if set(value) != {"shape", "zlib"}:
        raise InputError(f"{owner} must be lists of numbers, or shape and zlib as gns_pl writes them.")
    try:
        shape = [int(length) for length in value["shape"]]
        size = math.prod(shape)
        if min(shape) < 1 or size > MOST:
            raise ValueError
        unpacked = zlib.decompressobj().decompress(base64.b64decode(value["zlib"], validate=True), 8 * size + 1)
        return np.frombuffer(unpacked, dtype="<f8").astype(np.float64).reshape(shape)
    except (TypeError, ValueError, binascii.Error, zlib.error):
        raise InputError(f"{owner}: its numbers are damaged.") from None
