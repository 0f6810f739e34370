"""`start` runs a command as a user typed it; `job` is around the work of one config, of which a sweep has several."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

import gns_pl
from gns_pl.commands.arguments import prepared
from gns_pl.commands.help import help_text
from gns_pl.commands.known import check_known
from gns_pl.commands.telling import error_message, general_message
from gns_pl.errors import InputError, report_input_errors
from gns_pl.machine import prepare_process
from gns_pl.text import file_label

CONF = Path(gns_pl.__file__).parent / "conf"
"""The configuration: conf/ of the repository, to which a link leads here, and a copy of it in an installed package."""

FULL_ERROR = "HYDRA_FULL_ERROR"
GOES_ON = "stopped; the same command goes on where it was."


def start(main: Callable[[], Any], config_name: str) -> None:
    """Run a command with the arguments that it was started with.

    Args:
        main: its function, decorated by `hydra.main`.
        config_name: its file in conf/, without the ending.

    Raises:
        SystemExit: status 2 after a sentence on stderr, for all that a user can mend.
    """
    prepare_process()
    file = Path(inspect.getfile(inspect.unwrap(main)))
    config = CONF / f"{config_name}.yaml"
    typed = sys.argv[1:]
    if {"-h", "--help"} & set(typed):
        print(help_text(config))
        return
    traceback_wanted = os.environ.get(FULL_ERROR) == "1"
    os.environ[FULL_ERROR] = "1"  # Hydra hands its errors on, in place of printing them and ending
    sys.argv[1:] = prepared(typed, config)
    try:
        main()
    except Exception as error:
        if traceback_wanted or not is_told(error):
            raise
        if not getattr(error, "was_reported", False):
            print(f"{file.name}: {error_message(error, typed, config)}", file=sys.stderr)
        raise SystemExit(2) from error
    finally:
        sys.argv[1:] = typed
        os.environ[FULL_ERROR] = "1" if traceback_wanted else "0"


def is_told(error: Exception) -> bool:
    """Return whether an error is of what was typed, so that a sentence says enough."""
    if isinstance(error, OSError):
        return error.filename is not None or isinstance(error, HydraException)
    if isinstance(error, InputError | HydraException | OmegaConfBaseException | YAMLError):
        return True
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return place is not None and str(place.tb_frame.f_globals.get("__name__")).startswith("hydra.")


@contextmanager
def job(name: str, cfg: DictConfig, *, on_stop: str = GOES_ON) -> Iterator[None]:
    """Refuse a config with keys or types that are not the command's, and tell what the work refuses.

    Args:
        name: of the command's file.
        cfg: the config of this job.
        on_stop: what is told after Ctrl-C.
    """
    with report_input_errors(name, in_sweep=HydraConfig.get().mode == RunMode.MULTIRUN):
        try:
            check_known(cfg)
            yield
        except KeyboardInterrupt:
            raise SystemExit(f"{name}: {on_stop}") from None
        except (HydraException, OmegaConfBaseException, YAMLError) as error:
            raise InputError(general_message(error)) from error


def sweep_label() -> str:
    """Return what tells the job that is running from the others of its sweep, for names of files; "" outside sweeps."""
    hydra = HydraConfig.get()
    if hydra.mode != RunMode.MULTIRUN:
        return ""
    shared = set(hydra.job.config.override_dirname.exclude_keys)
    swept = [pair.lstrip("+").split("=", 1) for pair in hydra.overrides.task]
    swept = [pair for pair in swept if pair[0] not in shared and not pair[0].startswith("changes.")]
    return file_label(*("_".join(pair) for pair in swept if pair[0] != "scene"))  # a scene's own name tells it apart
