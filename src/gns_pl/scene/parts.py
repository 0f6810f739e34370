"""A dataclass from plain values; unknown and missing keys are named."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError
from gns_pl.text import did_you_mean


def part_from_dict(cls: type, owner: str, data: Any) -> Any:
    """Construct a dataclass from a mapping; unknown and missing keys are named."""
    if not isinstance(data, Mapping):
        raise InputError(f"{owner} must be a mapping of names to values, not {type(data).__name__}.")
    known = {field.name: field for field in dataclasses.fields(cls)}
    unknown = [str(key) for key in data if key not in known]
    if unknown:
        meant = did_you_mean(unknown[0], known)
        raise InputError(f"{owner}: unknown key {', '.join(unknown)}{meant}; known are {', '.join(known)}.")
    missing = [name for name, f in known.items() if f.default is dataclasses.MISSING and name not in data]
    if missing:
        raise InputError(f"{owner}: missing key {', '.join(missing)}.")
    return cls(**data)
