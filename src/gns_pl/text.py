"""What is printed for people to read and to type: commands that a shell and Hydra take as they are meant.

Only text from plain values belongs here; nothing that knows a scene, a run or a file's content.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

PLAIN = re.compile(r"(?!(?i:null|true|false|[+-]?(nan|inf|[0-9._]+(e[+-]?[0-9_]+)?))$)[A-Za-z0-9_./:+%@-]+")
"""Values that Hydra's grammar reads as they stand, as text; everything else is quoted."""


def quoted_value(value: str | Path) -> str:
    r"""Return a text as Hydra's grammar reads it back: as it stands where that is safe, in double quotes elsewhere.

    A quote is escaped, and so are the backslashes before one; `${` is escaped, for it is part of the text and no
    interpolation (https://hydra.cc/docs/advanced/override_grammar/basic, "Quoted values").
    """
    text = str(value)
    if PLAIN.fullmatch(text):
        return text
    escaped = re.sub(r'(\\*)("|$)', lambda found: found[1] * 2 + ('\\"' if found[2] else ""), text)
    return '"' + re.sub(r"(\\*)\$\{", lambda found: found[1] * 2 + r"\${", escaped) + '"'


def override(key: str, value: str | Path) -> str:
    """Return `key=value` as one word for a shell, for every name that a file system takes.

    Every command that is printed for a user to type is put together from this.
    """
    return shlex.quote(f"{key}={quoted_value(value)}")
