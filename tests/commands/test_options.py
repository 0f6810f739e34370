"""The options of every command are frozen in options/COMMAND.txt: a new one is argued for where the file changes.

    python tests/commands/test_options.py    # writes the files anew

A file lists the config groups with what can be chosen of each, then every key that can be typed, composed by Hydra with
each choice in turn. Experiments and sweeps set keys of the others and are listed by name alone; what users name
themselves, as a column or a family of scenes, stands as NAME.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from gns_pl.commands.arguments import default_groups
from gns_pl.commands.command import CONF
from gns_pl.commands.help import ADDED
from gns_pl.commands.known import all_keys
from gns_pl.commands.telling import options
from gns_pl.training import sweep  # registers the resolvers of conf/train.yaml

FROZEN = Path(__file__).parent / "options"
COMMANDS = sorted(path.stem for path in CONF.glob("*.yaml"))
NAMED = re.compile(
    r"^(data\.families|evaluation\.columns|evaluation\.stress\.variants|choice\.hybrid|scenes)\.\w+(\.\d+)?"
)


def offered(command: str) -> list[str]:
    """Return the lines that a command's file has to hold: `GROUP=NAME` and dotted keys, the innermost alone."""
    assert sweep.SweepReport is not None
    config = CONF / f"{command}.yaml"
    groups = {group: options(config, group) for group in sorted(default_groups(config))}
    added = {group: options(config, group) for group in ADDED.get(command, ())}
    keys: set[str] = set()
    with initialize_config_dir(str(CONF), version_base=None):
        for choice in ["", *(f"{group}={name}" for group, names in groups.items() for name in names if len(names) > 1)]:
            needed = ["data=quickstart"] if command == "generate" and not choice.startswith("data=") else []
            composed = all_keys(compose(command, [*needed, *filter(None, [choice])]))
            keys.update(NAMED.sub(r"\1.NAME", key) for key in composed)
    owners = {key.rpartition(".")[0] for key in keys}
    chosen = [f"{group}={name}" for group, names in (groups | added).items() for name in names]
    return [*chosen, *sorted(keys - owners)]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_has_the_options_that_are_frozen(command: str) -> None:
    frozen = (FROZEN / f"{command}.txt").read_text(encoding="utf-8").splitlines()
    now = offered(command)
    new, gone = sorted(set(now) - set(frozen)), sorted(set(frozen) - set(now))
    assert now == frozen, (
        f"the options of {command} changed: new {new}, gone {gone}. One that is meant, and that no code instead of an "
        "option can serve, is frozen by `python tests/commands/test_options.py`; say in the commit what it is for."
    )


def test_every_frozen_file_is_of_a_command() -> None:
    assert sorted(path.stem for path in FROZEN.iterdir()) == COMMANDS


if __name__ == "__main__":
    for written in COMMANDS:
        (FROZEN / f"{written}.txt").write_text("\n".join(offered(written)) + "\n", encoding="utf-8")
