"""One sentence for what Hydra, OmegaConf and YAML refuse: what is wrong, and what may have been meant."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException, InstantiationException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import MarkedYAMLError

from gns_pl.commands.arguments import ASSIGNMENT, default_groups
from gns_pl.commands.known import unknown_key
from gns_pl.errors import InputError, file_error_message
from gns_pl.text import did_you_mean, override

EXTRAS = {
    "hydra/sweeper/optuna": "optuna",
    "hydra/launcher/joblib": "joblib",
    "hydra/launcher/submitit_slurm": "slurm",
    "hydra/launcher/submitit_local": "slurm",
    "hydra/launcher/ray": "ray",
}
"""Plugins of Hydra → the extra of this package that brings them."""


def error_message(error: Exception, arguments: Sequence[str], config: Path) -> str:
    """Return what is wrong with what was typed, and what to do.

    Args:
        error: what was raised.
        arguments: as the user typed them.
        config: the command's YAML file.
    """
    if isinstance(error, OverrideParseException):
        return _unreadable(error.override)
    if isinstance(error, MissingConfigException):
        return _missing_option(error, config)
    text = str(error) if str(error) else str(error.__cause__ or type(error).__name__)
    refused = re.match(
        r"(?:Could not override|Could not delete from config\.|Could not delete\. No match for) '(.*?)'", text
    )
    if refused:
        inner = getattr(error.__cause__, "full_key", None) or ""  # in a mapping that was typed
        return str(unknown_key(max(refused[1], inner, key=len), _usual(config, arguments)))
    if match := re.match(r"Could not append to config. An item is already at '(.*?)'", text):
        return f"{match[1]} exists already: leave out the +."
    if match := re.match(r"You must specify '(.*?)'", text):
        return f"which {match[1]}? {match[1]}=NAME; there are {', '.join(options(config, match[1]))}."
    if match := re.match(r"Multiple values for (\S+?)\.", text):
        return f"{match[1]}= is given more than once."
    return general_message(error)


def general_message(error: Exception) -> str:
    """Return what is wrong, where nothing is known of what was typed."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, MarkedYAMLError):
        return yaml_sentence(error)
    if isinstance(error, OSError) and not isinstance(error, HydraException):
        return file_error_message(error)
    cause = error.__cause__
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if isinstance(error, InstantiationException):
        target = re.sub(r".*?'([\w.]+)'.*", r"\1", lines[0])
        return f"{target}: {str(cause).splitlines()[0] if cause else lines[-1]}"
    if cause is not None and str(cause):
        lines = [f"{lines[0].rstrip('.:')}: {str(cause).splitlines()[0]}" if lines else str(cause).splitlines()[0]]
    key = getattr(error, "full_key", None) or getattr(cause, "full_key", None)
    return f"{key}: {lines[0]}" if key and str(key) not in lines[0] else lines[0]


def yaml_sentence(error: MarkedYAMLError) -> str:
    """Return where a YAML file cannot be read, and why."""
    mark = error.problem_mark or error.context_mark
    where = f"{mark.name}, line {mark.line + 1}: " if mark else ""
    return f"{where}is not YAML ({error.problem or error.context})."


def options(config: Path, group: str) -> list[str]:
    """Return the options of a config group that can be typed."""
    return sorted(path.stem for path in (config.parent / group).glob("*.yaml") if not path.stem.startswith("_"))


def _unreadable(argument: str) -> str:
    match = ASSIGNMENT.fullmatch(argument)
    if match is None or not match["value"] or not re.fullmatch(r"[\w.@/$-]+", match["key"]):
        return f"{argument!r} is not KEY=VALUE; write it without spaces around the =, and see --help for the keys."
    typed = override(match["key"], match["value"])
    return f"{argument}: the value cannot be read; if it is meant as text, type {match['plus']}{typed}"


def _missing_option(error: MissingConfigException, config: Path) -> str:
    if error.missing_cfg_file in EXTRAS:
        return f"{error.missing_cfg_file} is not installed: pip install 'gns_pl[{EXTRAS[error.missing_cfg_file]}]'."
    group, _, option = (error.missing_cfg_file or "").partition("/")
    known = options(config, group)
    if not option or not known:
        return str(error).splitlines()[0]
    what = "no such option, and no folder of a data set" if group == "data" else "no such option"
    return f"{group}={option}: there is {what}{did_you_mean(option, known)}; options are {', '.join(known)}."


def _usual(config: Path, arguments: Sequence[str]) -> DictConfig:
    """Return the config of a command as the groups that were typed give it."""
    with initialize_config_dir(str(config.parent), version_base=None):
        for chosen in (list(_groups(config, arguments)), []):
            try:
                return compose(config.stem, chosen)
            except (HydraException, OmegaConfBaseException):
                continue
        return compose(config.stem, ["data=quickstart"])  # generate.py has no data set of its own


def _groups(config: Path, arguments: Sequence[str]) -> Iterator[str]:
    defaults = default_groups(config)
    for argument in arguments:
        match = ASSIGNMENT.fullmatch(argument)
        if match and match["key"] in defaults and match["value"] in options(config, match["key"]):
            yield f"{match['key']}={match['value']}"
