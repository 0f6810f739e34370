"""What a user typed, made into what Hydra's grammar reads as it was meant.

A shell has taken its own quotes off already, so a name of a file arrives as it is in the file system, and Hydra would
read `=`, commas, brackets, spaces and quotes in it as its grammar. Values of the keys listed here are names: they are
quoted before Hydra sees them. Nothing of a config is read here but which groups it has.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser

from gns_pl.generation.stored import OPTION, is_dataset
from gns_pl.scene.changes import encoded
from gns_pl.text import quoted_value

LISTS = (
    *("ckpt", "scene", "sets", "evaluation.scenes", "choice.learned", "choice.corrected", "choice.fitted"),
    "hydra.searchpath",
)
"""Keys whose value is the name of a file, or a list of such names: [a,b]."""

NAMES = (
    *("resume", "data.root", "out", "cache", "start", "source", "target", "deck", "records", "publish"),
    *("weights.metadata", "weights.data", "choice.records", "choice.hybrid.*.learned", "hydra.run.dir"),
    *(
        "hydra.sweep.dir",
        "hydra.sweep.subdir",
        "logger.*.save_dir",
        "name",
        "description",
        "weights.description",
        "evaluation.stress.label",
    ),
)
"""Keys whose value is the name of one file or folder, or words of the user's own."""

LABELLED = {"simulate": ("out",), "evaluate": ("out",)}
"""Commands whose jobs of one sweep write side by side, and keys that need not be in the names of what they write."""

ENSEMBLE = ("ensemble.members", "ensemble.grid", "ensemble.thresholds")
"""Keys of an ensemble; what others begin with `ensemble.` it varies."""

QUOTED = re.compile(r'"(?:\\.|[^"\\])*"|' + r"'(?:\\.|[^'\\])*'", re.DOTALL)
SWEPT = re.compile(r"(choice|glob|range|interval|shuffle|sort|tag)\(.*\)", re.DOTALL)
ASSIGNMENT = re.compile(r"(?P<plus>\+{0,2})(?P<key>[^=~]+)=(?P<value>.*)", re.DOTALL)


def prepared(arguments: Sequence[str], config: Path) -> list[str]:
    """Return the arguments of a command as Hydra takes them.

    Args:
        arguments: as typed, without the command.
        config: the command's own YAML file; the folders beside it are the config groups.
    """
    sweeping = is_sweep(arguments)
    defaults, prepared, typed, swept = default_groups(config), [], [], set()
    for argument in arguments:
        match = ASSIGNMENT.fullmatch(argument)
        if match is None:
            prepared.append(argument)
            continue
        plus, key, value = match["plus"], match["key"], match["value"]
        if key == "data" and "data" in defaults and (root := _named_folders(value, sweeping)):
            prepared.append(f"data={OPTION}")
            plus, key, value = "", "data.root", root
        elif (config.parent / key).is_dir():
            plus = "" if key in defaults else "+"  # the only way that Hydra takes it
        elif config.stem == "simulate" and key.startswith("scene."):
            plus, key = "++", f"changes.{encoded(key.removeprefix('scene.'))}"
        elif config.stem == "simulate" and key.startswith("ensemble.") and key not in ENSEMBLE:
            plus, key = "++", f"ensemble.vary.{encoded(key.removeprefix('ensemble.'))}"
        elif any(fnmatchcase(key, pattern) for pattern in (*LISTS, *NAMES)):
            value = value_of(value, listed=key in LISTS, sweeping=sweeping)
        prepared.append(f"{plus}{key}={value}")
        typed.append(key)
        if len(parts_of(value)) > 1 or SWEPT.fullmatch(value):
            swept.add(key)
    if sweeping and config.stem in LABELLED:
        keys = dict.fromkeys([*LABELLED[config.stem], *(key for key in typed if key not in swept)])
        prepared.append(f"hydra.job.config.override_dirname.exclude_keys=[{','.join(map(quoted_value, keys))}]")
    return prepared


def is_sweep(arguments: Sequence[str]) -> bool:
    """Return whether arguments start several jobs, in which commas part values."""
    return any(
        argument in ("-m", "--multirun", "hydra.mode=MULTIRUN") or argument.lstrip("+").startswith("sweep=")
        for argument in arguments
    )


def default_groups(config: Path) -> set[str]:
    """Return the config groups of which a command always has an option."""
    defaults = yaml.safe_load(config.read_text(encoding="utf-8")).get("defaults", ())
    return {
        name for entry in defaults if isinstance(entry, Mapping) for name in entry if not name.startswith("override")
    }


def value_of(text: str, *, listed: bool, sweeping: bool) -> str:
    """Return a name as typed in Hydra's grammar.

    What is there under the whole text is meant by it, whatever is in the text. Otherwise quotes, `null`, `${…}`, a
    `~` at the beginning, lists where a key has them, and in a sweep commas keep their meaning.

    Args:
        text: as typed.
        listed: [a,b] is a list.
        sweeping: commas part the values of several jobs.
    """
    if exists(text):
        return quoted_value(text)
    parts = parts_of(text)
    if sweeping and len(parts) > 1:
        return ",".join(value_of(part, listed=listed, sweeping=True) for part in parts)
    if text in ("", "null") or QUOTED.fullmatch(text) or (sweeping and SWEPT.fullmatch(text)):
        return text
    if listed and text.startswith("[") and text.endswith("]"):
        inner = text[1:-1]
        elements = parts_of(inner) if inner.strip() else []
        elements = [element if exists(element) else element.strip() for element in elements]
        return f"[{','.join(value_of(each, listed=False, sweeping=False) for each in elements)}]"
    plain = re.sub(r"\\([\\()\[\]{}:=, ])", r"\1", text)  # escaped by hand, as Hydra's own documentation has it
    if plain != text and exists(plain):
        return quoted_value(plain)
    return quoted_value(_expanded(text), interpolated=True)


def parts_of(text: str) -> list[str]:
    """Return what commas part, outside quotes and brackets; one in the name of a file that is there parts nothing."""
    parts, start = [], 0
    while start <= len(text):
        commas = [match.start() for match in re.finditer(",", text) if match.start() >= start]
        end = next((end for end in (len(text), *reversed(commas)) if exists(text[start:end])), None)
        if end is None:
            end = _end_of_part(text, start)
        parts.append(text[start:end])
        start = end + 1
    return parts


def _end_of_part(text: str, start: int) -> int:
    """Return where the next comma outside quotes and brackets is, or the text ends."""
    depth, place = 0, start
    while place < len(text) and not (text[place] == "," and depth <= 0):
        quoted = None if text[start:place].strip() else QUOTED.match(text, place)
        if quoted:
            place = quoted.end()
            continue
        depth += (text[place] in "[({") - (text[place] in "])}")
        place += 1
    return place


def exists(text: str) -> bool:
    """Return whether there is a file or a folder of a name."""
    try:
        return bool(text) and Path(text).exists()
    except (OSError, ValueError):
        return False


def _named_folders(text: str, sweeping: bool) -> str | None:
    """Return data sets by their folders in Hydra's grammar, None if a config is named."""
    if is_dataset(text):
        return quoted_value(text.rstrip("/") or text)
    parts = parts_of(text)
    if sweeping and len(parts) > 1:
        folders = [_named_folders(part, False) for part in parts]
        return ",".join(filter(None, folders)) if all(folders) else None
    if QUOTED.fullmatch(text):
        plain = str(OverridesParser.create().parse_override(f"data={text}").value()).replace("\\${", "${")
    else:
        plain = _expanded(text)
    return quoted_value(plain) if plain != text and is_dataset(plain) else None


def _expanded(text: str) -> str:
    """Return a name with a `~` at its beginning as the home it stands for."""
    try:
        return str(Path(text).expanduser()) if text.startswith("~") else text
    except RuntimeError:  # nobody's home: a name that begins so
        return text
