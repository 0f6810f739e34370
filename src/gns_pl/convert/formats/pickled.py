"""Pickled NumPy arrays, read without running anything that stands in the pickle, and written for every NumPy.

Unpickling calls whatever a file names. Here the names of NumPy's reconstruction lead to the stand-ins below, which hold
plain values and check them; every other name is refused. NumPy itself gets a hostile dtype, shape or buffer at no time:
arrays are made at the end, from bytes of the right length and a type of plain numbers.

The interpreter is Python's own `pickle._Unpickler`: the one in C allocates as many memo slots as an opcode asks for.
"""

from __future__ import annotations

import math
import pickle
import re
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError

_PLAIN = re.compile(r"[<>|=]?[biuf][1248]")
DEEPEST = 4
"""Arrays in arrays: a set holds trajectories, these hold arrays, these numbers."""


class PickledType:
    """Stands for `numpy.dtype`: plain numbers, or objects.

    Args:
        code: "f4", "O", …
        state: what NumPy hands to `numpy.dtype` besides; without meaning.

    Raises:
        InputError: any other type.
    """

    def __init__(self, code: Any = None, *state: Any) -> None:
        if not isinstance(code, str) or not (_PLAIN.fullmatch(code) or code in ("O", "O8", "|O")):
            raise InputError(f"its pickle holds data of type {str(code)[:20]!r}; only plain numbers are read.")
        self.holds_objects = code.lstrip("|").startswith("O")
        self.code = code

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) < 5 or any(part is not None for part in state[2:5]):
            raise InputError("its pickle holds a structured data type; only plain numbers are read.")
        order = state[1]
        if order not in ("<", ">", "|", "="):
            raise InputError("its pickle holds a data type of unknown byte order.")
        if not self.holds_objects and self.code[0] not in "<>|=":
            self.code = order + self.code

    def numbers(self, content: Any, shape: tuple[int, ...], order: str) -> NDArray[Any]:
        """Return bytes as an array that owns them."""
        if isinstance(content, str):
            content = content.encode("latin1")  # of pickles that Python 2 wrote
        kind = np.dtype(self.code)
        if not isinstance(content, bytes | bytearray) or len(content) != math.prod(shape) * kind.itemsize:
            raise InputError("its pickle holds an array whose bytes do not fit its shape.")
        return np.frombuffer(bytes(content), dtype=kind).reshape(shape, order="F" if order == "F" else "C")


class PickledArray:
    """Stands for `numpy.ndarray`, empty until its state is set.

    Attributes:
        shape: its lengths.
        items: of an array of objects, flat.
        values: of an array of numbers.
    """

    def __init__(self) -> None:
        self.shape: tuple[int, ...] = (0,)
        self.items: list[Any] | None = None
        self.values: NDArray[Any] | None = None

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5:
            raise InputError("its pickle holds an array in an unknown form.")
        _, shape, kind, fortran, content = state
        self.shape = checked_shape(shape)
        if not isinstance(kind, PickledType):
            raise InputError("its pickle holds an array without a data type.")
        if kind.holds_objects:
            if not isinstance(content, list) or len(content) != math.prod(self.shape):
                raise InputError("its pickle holds an array whose items do not fit its shape.")
            self.items = content
        else:
            self.values = kind.numbers(content, self.shape, "F" if fortran else "C")


def checked_shape(shape: Any) -> tuple[int, ...]:
    """Return a shape of at most four lengths that are whole and not negative.

    Raises:
        InputError: anything else.
    """
    whole = isinstance(shape, tuple) and all(type(length) is int and length >= 0 for length in shape)
    if not whole or len(shape) > DEEPEST:
        raise InputError("holds an array whose shape is not a tuple of whole numbers.")
    return tuple(shape)


def _reconstruct(kind: Any = None, shape: Any = None, code: Any = None) -> PickledArray:
    if kind is not PickledArray:
        raise InputError("its pickle holds a subclass of NumPy's array; only arrays are read.")
    return PickledArray()


def _from_buffer(content: Any = None, kind: Any = None, shape: Any = None, order: Any = "C") -> PickledArray:
    array = PickledArray()
    array.__setstate__((1, shape, kind, order == "F", bytes(content) if isinstance(content, bytearray) else content))
    return array


def _scalar(kind: Any = None, content: Any = None) -> PickledArray:
    return _from_buffer(content, kind, (), "C")


def _encode(text: Any = None, encoding: Any = None) -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise InputError("its pickle asks for an encoding other than that of bytes.")
    return text.encode("latin1")


ADMITTED: dict[tuple[str, str], Any] = {("numpy", "ndarray"): PickledArray, ("numpy", "dtype"): PickledType}
"""Module and name in a pickle → its stand-in. Nothing else is found."""
for _module in ("numpy.core", "numpy._core"):
    ADMITTED |= {
        (f"{_module}.multiarray", "_reconstruct"): _reconstruct,
        (f"{_module}.multiarray", "scalar"): _scalar,
        (f"{_module}.numeric", "_frombuffer"): _from_buffer,
    }
ADMITTED["_codecs", "encode"] = _encode


class _Unpickler(pickle._Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in of a name."""
        found = ADMITTED.get((module, name))
        if found is None:
            raise InputError(
                f"its pickle asks for {module[:40]}.{name[:40]}, which is not NumPy's way to rebuild an array; it was "
                "not run, and the file may be hostile."
            )
        return found

    def get_extension(self, code: int) -> None:
        """Refuse names by number."""
        raise InputError("its pickle asks for a registered extension; it was not run.")


def read_pickle(stream: BinaryIO) -> Any:
    """Return what a pickle of NumPy arrays holds: arrays, numbers, text, and tuples, lists and dicts of these.

    Args:
        stream: at the beginning of the pickle.

    Raises:
        InputError: it asks for anything but NumPy's reconstruction, or is damaged; nothing of it was run.
    """
    try:
        return _Unpickler(stream, encoding="latin1").load()
    except InputError:
        raise
    except MemoryError:
        raise
    except Exception as error:  # the opcodes of a damaged pickle raise whatever they like
        raise InputError("its pickle is truncated or damaged.") from error


class _Pickler(pickle._Pickler):
    """Writes the functions of NumPy by the names that they have in NumPy 1 and 2 alike.

    NumPy 2 calls its inner package `numpy._core`, which NumPy 1 does not have; both find them under `numpy.core`.
    """

    def save_global(self, obj: Any, name: str | None = None) -> None:
        """Write the name of a function or a class."""
        module = str(getattr(obj, "__module__", ""))
        if not module.startswith("numpy._core"):
            super().save_global(obj, name)  # type: ignore[misc]
            return
        named = module.replace("numpy._core", "numpy.core", 1), name or obj.__name__
        self.write(pickle.GLOBAL + "{}\n{}\n".format(*named).encode("ascii"))  # type: ignore[attr-defined]
        self.memoize(obj)  # type: ignore[attr-defined]


def write_pickle(stream: BinaryIO, value: NDArray[Any]) -> None:
    """Write an array of arrays as every NumPy since 1.16 reads it.

    Args:
        stream: open for writing.
        value: array of objects, NumPy arrays.
    """
    _Pickler(stream, protocol=4).dump(value)


def plain(value: Any, depth: int = 0) -> Any:
    """Return numbers as arrays, and arrays of objects, tuples and lists as lists; deeper than `DEEPEST` is refused.

    Raises:
        InputError: anything else.
    """
    if depth > DEEPEST:
        raise InputError("its pickle nests arrays too deeply.")
    if isinstance(value, PickledArray):
        if value.values is not None:
            return value.values
        items = value.items or []
        if len(value.shape) == 2:  # rows of one trajectory each
            width = value.shape[1]
            return [[plain(each, depth + 2) for each in items[k : k + width]] for k in range(0, len(items), width or 1)]
        return plain(items[0], depth + 1) if value.shape == () else [plain(each, depth + 1) for each in items]
    if isinstance(value, tuple | list):
        return [plain(each, depth + 1) for each in value]
    if isinstance(value, bool | int | float):
        return np.asarray(value)
    raise InputError(f"its pickle holds a {type(value).__name__} where an array should be.")
