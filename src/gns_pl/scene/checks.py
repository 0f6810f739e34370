"""Checks of single values, shared by every part of a scene: each names its owner and the field in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError


def checked_numbers(owner: str, name: str, values: Any, dim: int | None = None) -> tuple[float, ...]:
    """Return `values` as a tuple of finite floats, or raise an `InputError` that names the field."""
    try:
        if isinstance(values, str | bytes | Mapping) or any(isinstance(value, bool) for value in values):
            raise TypeError
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        raise InputError(f"{owner}: {name} must be a list of numbers, not {values!r}.") from None
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{owner}: {name} must hold finite numbers, not {list(numbers)}.")
    if dim is not None and len(numbers) != dim:
        raise InputError(f"{owner}: {name} must have {dim} entries as the domain does, not {len(numbers)}.")
    return numbers


def checked_number(owner: str, name: str, value: Any, lower: float = -math.inf, *, above: bool = False) -> float:
    """Return `value` as a finite float of at least `lower` (more than `lower` if `above`), or raise an `InputError`."""
    try:
        if isinstance(value, bool):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{owner}: {name} must be a number, not {value!r}.") from None
    if not math.isfinite(number) or number < lower or (above and number == lower):
        bound = "" if lower == -math.inf else f" {'above' if above else 'of at least'} {lower:g}"
        raise InputError(f"{owner}: {name} must be a finite number{bound}, not {value}.")
    return number
