"""`--help` of a command: what it is for, two examples, its own groups, and every setting with its meaning."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from gns_pl.commands.arguments import default_groups
from gns_pl.commands.telling import options
from gns_pl.text import command

ADDED = {"train": ("experiment", "sweep")}
"""Groups of which a command has no option unless one is named."""

USE = (
    "KEY=VALUE sets a value, GROUP=NAME takes a file of a group, -m KEY=A,B runs a job for each value, and --cfg job "
    "prints all settings."
)


def help_text(config: Path) -> str:
    """Return the help of a command from its YAML file: `hydra.help` of it, its groups, and its settings as they stand.

    Args:
        config: the command's YAML file.
    """
    text = config.read_text(encoding="utf-8")
    head = yaml.safe_load(text)["hydra"]["help"]
    groups = [*sorted(default_groups(config)), *ADDED.get(config.stem, ())]
    listed = [f"  {name}={'|'.join(options(config, name))}" for name in groups if options(config, name)]
    lines = "\n".join(
        [
            head["header"].strip(),
            "",
            *(f"  {line}" for line in head["footer"].strip().splitlines()),
            "",
            USE,
            *(["", "Groups:", *listed] if listed else []),
            "",
            f"Settings (conf/{config.name}):",
            *(f"  {line}".rstrip() for line in _settings(text)),
        ]
    )
    return re.sub(r"python (\w+)\.py", lambda match: command(match[1]), lines)


def _settings(text: str) -> list[str]:
    """Return the lines of a YAML file without its first comments, its defaults and what is Hydra's own."""
    shown: list[str] = []
    skipped = True
    for line in text.splitlines():
        if re.match(r"\w", line):
            skipped = line.startswith(("defaults:", "hydra:"))
        elif not line and (skipped or not shown):
            continue
        if not skipped:
            shown.append(line)
    return shown
