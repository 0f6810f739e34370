"""The package with the edits that docs/extend.md asks for: edited copies of a few files in the place of the files."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.extend.page import ROOT

PACKAGE = ROOT / "src" / "gns_pl"

PRELUDE = """
import importlib.util, sys


class Edited:
    @staticmethod
    def find_spec(name, path=None, target=None):
        return importlib.util.spec_from_file_location(name, {files}[name]) if name in {files} else None


sys.meta_path.insert(0, Edited)
"""


class Overlay:
    """Edits of files of the package, and of new ones.

    Args:
        folder: where the edited files are put; programs run there, and keep their compiled code there if they are to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files: dict[str, str] = {}

    def edit(self, file: str, *changes: tuple[str, str]) -> None:
        """Replace pieces of text, of which there is one each, in a file of the package."""
        text = (PACKAGE / file).read_text(encoding="utf-8")
        for before, after in changes:
            assert text.count(before) == 1, f"{file} has {text.count(before)} times {before!r}"
            text = text.replace(before, after)
        self.add(file, text)

    def add(self, file: str, text: str) -> None:
        """Put a file into the package."""
        name = file.removesuffix(".py").replace("/", ".")
        path = self.folder / f"{name}.py"
        path.write_text(text, encoding="utf-8")
        self._files[f"gns_pl.{name}"] = str(path)

    def run(self, program: str, **environment: str) -> str:
        """Run Python code in a process of its own, where the edited files are the package's, and return its output."""
        code = PRELUDE.format(files=self._files) + program
        variables = os.environ | {"PYTHONPATH": os.pathsep.join([str(PACKAGE.parent), str(ROOT)])} | environment
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=self.folder, env=variables, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout
