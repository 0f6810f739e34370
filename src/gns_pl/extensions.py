"""What users add from outside: a class or a function named "MODULE.NAME", from a package or from the working folder."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any, TypeVar

from gns_pl.errors import InputError

T = TypeVar("T")


def imported(name: str, kind: type[T], key: str, known: list[str]) -> type[T]:
    """Return a class by its dotted name.

    Args:
        name: "MODULE.CLASS".
        kind: what it has to be.
        key: of the setting that names it, for messages.
        known: names that need no module, for messages.

    Raises:
        InputError: no such module, no such class in it, or a class of another kind.
    """
    value = _import(name, key, known, "CLASS")
    if not (isinstance(value, type) and issubclass(value, kind)):
        raise InputError(f"{key}={name}: is no subclass of {kind.__module__}.{kind.__name__}.")
    return value


def imported_function(name: str, key: str, known: list[str]) -> Any:
    """Return what can be called, by its dotted name; arguments as of `imported`.

    Raises:
        InputError: no such module, no such name in it, or nothing that can be called.
    """
    value = _import(name, key, known, "FUNCTION")
    if not callable(value):
        raise InputError(f"{key}={name}: is no function.")
    return value


def _import(name: str, key: str, known: list[str], what: str) -> Any:
    module, _, attribute = name.rpartition(".")
    if not module:
        raise InputError(f"{key} must be one of {', '.join(known)}, or MODULE.{what} of your own, not {name!r}.")
    here = str(Path.cwd())
    sys.path.append(here)
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"{key}={name}: {error}; it is looked for among packages and in {here}.") from error
    finally:
        sys.path.remove(here)
