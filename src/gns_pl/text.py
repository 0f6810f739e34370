"""What is printed for people to read and to type: commands that a shell and Hydra take as they are meant.

Only text from plain values belongs here; nothing that knows a scene, a run or a file's content.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from difflib import SequenceMatcher
from hashlib import sha256
from pathlib import Path

PLAIN = re.compile(r"(?!(?i:null|true|false|[+-]?(nan|inf|[0-9._]+(e[+-]?[0-9_]+)?))$)[A-Za-z0-9_./:+%@-]+")
"""Values that Hydra's grammar reads as they stand, as text; everything else is quoted."""

LONGEST_LABEL = 100
"""Characters of a file's name that say what was changed; the longest name on most file systems has 255 bytes."""

LIKELY = 0.6
"""How similar, from 0 to 1, a name is at least to one that may have been meant."""


def quoted_value(value: str | Path, *, interpolated: bool = False) -> str:
    r"""Return a text as Hydra's grammar reads it back: as it stands where that is safe, in double quotes elsewhere.

    A quote is escaped, and so are the backslashes before one; `${` is escaped, for it is part of the text and no
    interpolation (https://hydra.cc/docs/advanced/override_grammar/basic, "Quoted values").

    Args:
        value: the text.
        interpolated: leave `${…}` an interpolation.
    """
    text = str(value)
    if PLAIN.fullmatch(text):
        return text
    escaped = re.sub(r'(\\*)("|$)', lambda found: found[1] * 2 + ('\\"' if found[2] else ""), text)
    if not interpolated:
        escaped = re.sub(r"(\\*)\$\{", lambda found: found[1] * 2 + r"\${", escaped)
    return f'"{escaped}"'


def override(key: str, value: str | Path) -> str:
    """Return `key=value` as one word for a shell, for every name that a file system takes.

    Every command that is printed for a user to type is put together from this.
    """
    return shlex.quote(f"{key}={quoted_value(value)}")


def file_label(*changes: str) -> str:
    """Return what was changed, as a part of a file's name; what would be too long is cut and ends in a hash."""
    text = "_".join(changes)
    label = re.sub(r"_*[^\w.+-]+_*", "_", text).strip("_")
    if len(label.encode()) > LONGEST_LABEL:
        label = f"{label.encode()[:LONGEST_LABEL].decode(errors='ignore')}_{sha256(text.encode()).hexdigest()[:8]}"
    return label


def nearest(name: str, known: Iterable[str], *, dotted: bool = False) -> list[str]:
    """Return up to three of the known names that may have been meant, the most similar first.

    Args:
        name: what was typed.
        known: the names that there are.
        dotted: names are keys of a config, as `training.batch_size`; their last parts are compared as well.
    """

    def similar(first: str, second: str) -> float:
        return SequenceMatcher(None, first.lower(), second.lower(), autojunk=False).ratio()

    scores: dict[str, float] = {}
    for each in known:
        scores[each] = similar(name, each)
        if dotted:
            scores[each] = max(scores[each], 0.99 * similar(name.rpartition(".")[2], each.rpartition(".")[2]))
    likely = sorted((each for each in scores if scores[each] >= LIKELY), key=lambda each: (-scores[each], each))
    return [each for each in likely if scores[each] >= scores[likely[0]] - 0.1][:3]


def did_you_mean(name: str, known: Iterable[str], *, dotted: bool = False) -> str:
    """Return " (did you mean X?)" with the most similar of the known names, or nothing; arguments as of `nearest`."""
    found = nearest(name, known, dotted=dotted)
    return f" (did you mean {' or '.join(found)}?)" if found else ""
