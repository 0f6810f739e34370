"""Material laws by name: the shipped one, those that were registered, and those of a user's own module.

A law takes the place of `constitutive.material_law` in every kernel, on CPU and GPU. It is a module-level function of
numbers that numba can compile; it may call functions made by `numba.njit` and read numbers of its module.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from gns_pl.errors import InputError
from gns_pl.extensions import imported_function

DRUCKER_PRAGER = "drucker_prager"
"""The law of `constitutive.return_map`."""

LAWS: dict[str, Callable[..., tuple[float, float]]] = {}
"""Name → law, besides the shipped one; `register_law` adds."""

PROBE = (1e3, 2e3, 1.0, 1e-4, 1e6, 2e6, 0.5, 100.0, 0.1, 50.0)
"""Arguments of `constitutive.material_law` with which a law is tried before a run."""


@dataclass(frozen=True)
class Law:
    """A law in the place of the shipped one.

    Attributes:
        kernel: made by numba.
        digest: hash of its code and of all that the code names.
    """

    kernel: Any
    digest: str


def register_law(name: str, law: Callable[..., tuple[float, float]]) -> Callable[..., tuple[float, float]]:
    """Make a material law known by a name in this process, and return it."""
    LAWS[name] = law
    return law


def find_law(name: str) -> Law | None:
    """Return the law of a name; None for the shipped one.

    Args:
        name: of a known law, or "MODULE.FUNCTION".

    Raises:
        InputError: there is none, or it cannot be compiled or gives no two numbers.
    """
    if name == DRUCKER_PRAGER:
        return None
    law = LAWS[name] if name in LAWS else imported_function(name, "mpm.law", [DRUCKER_PRAGER, *sorted(LAWS)])
    return _compiled_law(name, law)


def law_names(law: Law | None) -> dict[str, Any]:
    """Return what names of kernels mean under a law, as of `compiled.variant`."""
    return {} if law is None else {"material_law": law.kernel}


@cache
def _compiled_law(name: str, law: Any) -> Law:
    import numba
    from numba.core.dispatcher import Dispatcher
    from numba.core.errors import NumbaError

    from gns_pl.mpm.compiled import compiled

    function = getattr(law, "py_func", law)
    if getattr(function, "__code__", None) is None or function.__closure__:
        raise InputError(f"mpm.law={name}: must be a function of a module, made by no other function.")
    try:
        result = numba.njit(function)(*PROBE)
        sound = len(result) == 2 and all(math.isfinite(number) for number in result)
    except NumbaError as error:
        reason = next((line for line in str(error).splitlines()[1:] if line.strip()), str(error)).strip()
        raise InputError(f"mpm.law={name}: numba cannot compile it: {reason}") from error
    except Exception as error:
        raise InputError(f"mpm.law={name}: fails on a plain state: {error}") from error
    if not sound:
        raise InputError(f"mpm.law={name}: must return pressure and factor, two finite numbers, not {result}.")
    return Law(law if isinstance(law, Dispatcher) else compiled(function), _digest(function))


def _digest(function: Any) -> str:
    """Return a hash of a function's code, of the functions it calls and of the values it reads."""
    hashed, seen = hashlib.sha256(), set[Any]()

    def add_code(code: CodeType, names: dict[str, Any]) -> None:
        hashed.update(code.co_code + repr((code.co_names, code.co_varnames)).encode())
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                add_code(constant, names)
            else:
                hashed.update(repr(constant).encode())
        for name in sorted(set(code.co_names) & set(names)):
            add_value(name, names[name])

    def add_value(name: str, value: Any) -> None:
        called = getattr(value, "py_func", value)
        hashed.update(name.encode())
        if isinstance(called, ModuleType):
            file = getattr(called, "__file__", None) or ""
            hashed.update(Path(file).read_bytes() if file.endswith(".py") else called.__name__.encode())
        elif hasattr(called, "__code__"):
            if called not in seen:
                seen.add(called)
                add_code(called.__code__, called.__globals__)
        else:
            hashed.update(repr(value).encode())

    add_value("law", function)
    return hashed.hexdigest()[:12]
