"""Changes of a scene by dotted keys, as `scene.bodies.0.velocity=[1,0,0]` is typed, in its plain form."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError
from gns_pl.text import did_you_mean, file_label


def encoded(key: str) -> str:
    """Return any key of a scene, as `walls.x+.friction`, in characters that Hydra's grammar has for keys."""
    return re.sub(r"[^A-Za-z0-9_-]", lambda match: f"${ord(match[0]):x}$", key)


def decoded(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return changes with their keys as they were typed; the inverse of `encoded`."""
    return {re.sub(r"\$([0-9a-f]+)\$", lambda match: chr(int(match[1], 16)), key): changes[key] for key in changes}


def changes_label(changes: Mapping[str, Any]) -> str:
    """Return what the name of a changed scene ends in, as `aspect_ratio_2`; a new name is none of it."""
    return file_label(*(f"{key}_{changes[key]}" for key in sorted(changes) if key != "name"))


def changed(data: Any, changes: Mapping[str, Any], owner: str) -> Any:
    """Return the plain form of a scene with changes.

    Args:
        data: a scene as plain dicts and lists.
        changes: dotted key → value; numbers in a key count the entries of a list from 0, and the number of its entries
            stands for a new one.
        owner: file or name of the scene, for messages.

    Raises:
        InputError: a key that leads nowhere.
    """
    data = copy.deepcopy(data)
    for key, value in changes.items():
        *way, last = key.split(".")
        place = data
        for depth, part in enumerate(way):
            place = _inside(place, part, ".".join(way[: depth + 1]), owner)
        if isinstance(place, list):
            number = _number(place, last, key, owner, new=True)
            place[number : number + 1] = [value]
        elif isinstance(place, dict):
            place[last] = value
        else:
            raise InputError(f"scene.{key}: {'.'.join(way)} of {owner} is {place!r}, which has no parts.")
    return data


def _inside(place: Any, part: str, key: str, owner: str) -> Any:
    """Return the part of a mapping or a list."""
    if isinstance(place, list):
        return place[_number(place, part, key, owner)]
    if not isinstance(place, dict) or part not in place:
        known = list(place) if isinstance(place, dict) else []
        there = f"there are {', '.join(known)}" if known else "it has no parts"
        raise InputError(f"scene.{key}: {owner} has no such key{did_you_mean(part, known)}; {there}.")
    return place[part]


def _number(place: list[Any], part: str, key: str, owner: str, *, new: bool = False) -> int:
    if not part.isdecimal() or int(part) >= len(place) + new:
        known = f"0 to {len(place) - 1}" if place else "none"
        raise InputError(f"scene.{key}: {part} is no entry of {owner}; there are {known}.")
    return int(part)
