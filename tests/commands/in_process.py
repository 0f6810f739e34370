"""Commands as a user types them, in this process: the file itself is run, without the seconds of a new interpreter.

What only a process of its own shows (what is imported, what a kill leaves, torchrun) is tested with one; so is one
whole run of every command.
"""

from __future__ import annotations

import contextlib
import io
import os
import runpy
import subprocess
import sys
import traceback
import warnings
from pathlib import Path
from unittest import mock

from hydra.core.global_hydra import GlobalHydra

ROOT = Path(__file__).parents[2]


def call(folder: Path, name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command in `folder`, and return what a process would have: its status and what it printed.

    Args:
        folder: the working directory.
        name: of the command's file, such as "train.py".
        *arguments: that are typed behind it.
    """
    stdout, stderr, status = io.StringIO(), io.StringIO(), 0
    GlobalHydra.instance().clear()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(stdout),
        contextlib.redirect_stderr(stderr),
        mock.patch.object(sys, "argv", [str(ROOT / name), *arguments]),
        mock.patch.dict(os.environ),
        warnings.catch_warnings(),
    ):
        try:
            runpy.run_path(str(ROOT / name), run_name="__main__")
        except SystemExit as error:
            if isinstance(error.code, str):
                print(error.code, file=sys.stderr)
            status = error.code if isinstance(error.code, int) else int(error.code is not None)
        except Exception:
            traceback.print_exc()
            status = 1
    GlobalHydra.instance().clear()
    return subprocess.CompletedProcess([name, *arguments], status, stdout.getvalue(), stderr.getvalue())
