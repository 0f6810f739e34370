"""What is printed for people to read and to type: numbers, times, overrides that shell and Hydra read as meant.

Only text from plain values belongs here; nothing that knows a scene, a run or a file's content.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable
from difflib import SequenceMatcher
from hashlib import sha256
from pathlib import Path
from typing import Any

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
    escaped = re.sub(r'(\\*)("|$)', lambda match: match[1] * 2 + ('\\"' if match[2] else ""), text)
    if not interpolated:
        escaped = re.sub(r"(\\*)\$\{", lambda match: match[1] * 2 + r"\${", escaped)
    return f'"{escaped}"'


def override(key: str, value: str | Path) -> str:
    """Return `key=value` as one word for a shell, for every name that a file system takes.

    Every command that is printed for a user to type is put together from this.
    """
    return shlex.quote(f"{key}={quoted_value(value)}")


def shown_path(path: str | Path) -> str:
    """Return a path relative to the working directory if it lies below it."""
    path = Path(path)
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


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
    for other in known:
        scores[other] = similar(name, other)
        if dotted:
            scores[other] = max(scores[other], 0.99 * similar(name.rpartition(".")[2], other.rpartition(".")[2]))
    likely = sorted((other for other in scores if scores[other] >= LIKELY), key=lambda other: (-scores[other], other))
    return [other for other in likely if scores[other] >= scores[likely[0]] - 0.1][:3]


def did_you_mean(name: str, known: Iterable[str], *, dotted: bool = False) -> str:
    """Return " (did you mean X?)" with the most similar of the known names, or nothing; arguments as of `nearest`."""
    likely = nearest(name, known, dotted=dotted)
    return f" (did you mean {' or '.join(likely)}?)" if likely else ""


def number(value: float | None, std: float | None = None) -> str:
    """Return three significant digits, "–" for None; with one of a standard deviation behind "±"."""
    if value is None:
        return "–"
    after = f" ± {std:.1g}" if std else ""
    if value == 0:
        return f"0{after}"
    plain = f"{value:.2e}" if not 1e-3 <= abs(value) < 1e5 else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return plain + after


def percent(value: float | None, std: float | None = None) -> str:
    """Return a relative error in per cent with its sign, "" for None; with a standard deviation behind "±"."""
    if value is None:
        return ""
    return f"{100 * value:+.1f}{'' if std is None else f' ± {100 * std:.1f}'} %"


def without_nan(value: Any) -> Any:
    """Return `value` with every float that is not finite replaced by None, through dicts and lists."""
    if isinstance(value, dict):
        return {key: without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def seconds(value: float) -> str:
    """Return a time with its unit."""
    if value != value:
        return "unknown"
    if value == float("inf"):
        return "never"
    if value < 1e-4:
        return f"{1e6 * value:.2g} µs"
    if value < 0.01:
        return f"{1e3 * value:.2g} ms"
    return f"{value:.3g} s" if value < 600 else f"{value / 60:.3g} min"


_program = ["python {}.py"]


def use_program(form: str) -> None:
    """Say how commands are typed from here on, with {} in the place of their names."""
    _program[0] = form


def command(name: str) -> str:
    """Return how a command is typed: "python train.py" in the repository, "gns-pl train" of an installed package."""
    return _program[0].format(name)
