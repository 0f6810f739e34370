"""The decorator of every kernel of this room, and the variants that are made of one source.

`compiled` is numba's `njit` with a cache that knows all sources of the room: numba's own looks at the file of the
function called, not at those of the functions it calls, so that after an edit of `constitutive.py` a cached `advance`
would go on with the old law, silently. Here the cache lies in a folder named by a hash over all sources.

A kernel is written once, for quadratic shape functions in double precision on the CPU. `variant` makes the others: it
copies the function with another namespace, in which names mean something else (`axis_shape` the linear shape
functions, `real` and every float constant single precision, `add` an atomic addition on a GPU), and does the same with
every kernel it calls.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from gns_pl.machine import compile_function

FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
"""Everything of fastmath that keeps NaN and infinity meaningful: a failed run must be seen to fail."""


def _subfolder() -> str:
    """Name the folder of this room's compiled code."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    return f"mpm-{digest.hexdigest()[:12]}"


SUBFOLDER = _subfolder()


def compiled(function: Callable[..., Any], name: str = "", *, parallel: bool = False) -> Any:
    """Compile a module-level function with `njit`: cached, without the GIL, NaN kept.

    Every kernel is put into its callers whole. Left to choose, LLVM keeps some as functions, of which a process that
    has just compiled them and one that loads them from the cache run different code, and the last bits differ.

    Args:
        function: to compile.
        name: of its variant; each has a folder of its own, since numba tells functions apart by their code alone.
        parallel: let `prange` run on several threads.
    """
    options = {"parallel": True} if parallel else {"forceinline": True}
    return compile_function(function, f"{SUBFOLDER}/{name}", nogil=True, fastmath=FASTMATH, **options)


def variant(
    kernel: Any, precision: str, names: Mapping[str, Any], compile_function: Callable[[Callable[..., Any]], Any]
) -> Any:
    """Return a kernel made of the same source under another meaning of names, with all kernels that it calls.

    Args:
        kernel: made by `compiled`.
        precision: "float64" or "float32"; with the latter every float constant is a float32, and so is `real`.
        names: global names of the kernels → what they mean here.
        compile_function: makes a kernel of a Python function.
    """
    done: dict[Any, Any] = {}

    def copy(dispatcher: Any) -> Any:
        if dispatcher not in done:
            function = dispatcher.py_func
            namespace = {name: _translated(value, precision) for name, value in function.__globals__.items()}
            code = function.__code__
            for name in set(code.co_names) & set(namespace):
                meant = names.get(name, namespace[name])
                namespace[name] = copy(meant) if isinstance(meant, Dispatcher) else meant
            code = code.replace(co_consts=tuple(_translated(value, precision) for value in code.co_consts))
            again = FunctionType(code, namespace, function.__name__, function.__defaults__)
            again.__qualname__, again.__module__ = function.__qualname__, function.__module__
            done[dispatcher] = compile_function(again)
        return done[dispatcher]

    return copy(kernel)


def _translated(value: Any, precision: str) -> Any:
    """A constant in the precision wanted; everything else as it is."""
    if precision == "float64":
        return value
    if value is np.float64:
        return np.float32
    if isinstance(value, tuple):
        return tuple(_translated(item, precision) for item in value)
    return np.float32(value) if type(value) is float else value
