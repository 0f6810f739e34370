"""Commands that the documents show have keys and kinds of values that the commands take."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from gns_pl.commands.arguments import prepared
from tests.commands.test_known import check

ROOT = Path(__file__).parents[2]
SHOWN = re.compile(r"python (train|generate|simulate|evaluate|benchmark|convert|fit)\.py((?: [^`#|\n]+)?)")
PLACEHOLDER = re.compile(r"…|\.\.\.|[A-Z]{3,}|^\[|^<|:$|mine|install=|hydra[/.]launcher")


def shown() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each command of the documents once, without what stands for something of the reader's."""
    found = set()
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = re.sub(r"\\?\n {2,}(?=\S+=)", " ", page.read_text())  # commands that go on in the next line
        for command, rest in SHOWN.findall(text):
            words = (word for word in split(rest) if "=" in word and not PLACEHOLDER.search(word))
            arguments = tuple(re.sub(r"(=[^\[,{(]+),.*", r"\1", word) for word in words)  # of a sweep the first
            if arguments and (command, arguments) not in found:
                found.add((command, arguments))
                yield command, arguments


def split(words: str) -> list[str]:
    """Split as a shell does; sentences with one quotation mark by spaces."""
    try:
        return shlex.split(words)
    except ValueError:
        return words.split()


@pytest.mark.parametrize(("command", "arguments"), list(shown()))
def test_the_command_takes_what_is_shown(
    command: str, arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check(command, prepared(arguments, ROOT / "conf" / f"{command}.yaml"), tmp_path, monkeypatch)
