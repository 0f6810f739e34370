"""A command as a user types it, within this process: importing torch anew takes longer than what is tested."""

from __future__ import annotations

import os
import runpy
import sys
from dataclasses import dataclass
from typing import Any

import pytest

from tests.commands.test_train import ROOT


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        status: of its process.
        out: on stdout.
        err: on stderr.
    """

    status: Any
    out: str
    err: str


def typed(capsys: pytest.CaptureFixture[str], command: str, *arguments: str) -> Ended:
    """Run COMMAND.py with arguments as a shell hands them over; what nobody told a user passes through."""
    before, full = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    sys.argv = [f"{command}.py", *arguments]
    capsys.readouterr()
    status: Any = 0
    try:
        runpy.run_path(str(ROOT / f"{command}.py"), run_name="__main__")
    except SystemExit as end:
        status = end.code
    finally:
        sys.argv = before
        os.environ.pop("HYDRA_FULL_ERROR", None)
        if full is not None:
            os.environ["HYDRA_FULL_ERROR"] = full
    captured = capsys.readouterr()
    return Ended(status, captured.out, captured.err)
