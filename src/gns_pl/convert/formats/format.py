"""What a reader says of its format, and the path it looks at; `detect` asks one format after another."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from gns_pl.convert.formats.source import ForeignSet, reading
from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size

MOST_FILES = 1_000_000
PACKED = (".gz", ".bz2", ".xz", ".zst", ".zip")


@dataclass(frozen=True)
class Source:
    """A path that a user named, and what was said of it.

    Attributes:
        path: file or folder.
        known: endings of the files of all formats.
        trust: read pickled arrays, without running anything that stands in them.
        deck: JSON input of CB-Geo MPM runs.
        lost: "refuse" or "drop", of particles that leave CB-Geo's mesh.
    """

    path: Path
    known: Collection[str]
    trust: bool = False
    deck: Path | None = None
    lost: str = "refuse"

    @cached_property
    def files(self) -> dict[str, list[Path]]:
        """Ending → files of a folder, one level of folders in it among them, or a file alone.

        Raises:
            InputError: a file of a known ending that is none: a pipe, a device, a link to nothing; or packed data that
                would be left out, because it does not lie there unpacked as well.
        """
        if not self.path.is_dir():
            with reading(self.path):
                regular_size(self.path)
            files = {self.path.suffix: [self.path]}
        else:
            files = self._below()
        for ending in PACKED:
            for file in files.get(ending, ()):
                plain = file.with_suffix("")
                if plain.suffix in self.known and not plain.exists():
                    raise InputError(
                        f"{self.path}: {file.name} is packed and would be left out; unpack it, or take it away."
                    )
        return files

    def _below(self) -> dict[str, list[Path]]:
        found: dict[str, list[Path]] = {}
        for count, file in enumerate(sorted([*self.path.glob("*"), *self.path.glob("*/*")])):
            if count > MOST_FILES:
                raise InputError(f"{self.path}: has more than {MOST_FILES:,} files.")
            if file.name.startswith(".") or file.is_dir():
                continue
            if file.suffix in self.known:
                with reading(file):
                    regular_size(file)
            found.setdefault(file.suffix, []).append(file)
        order = {"train": 0, "valid": 1, "test": 2}
        return {
            ending: sorted(files, key=lambda file: (order.get(file.stem, 3), file)) for ending, files in found.items()
        }


@dataclass(frozen=True)
class Format:
    """A foreign format that can be read.

    Attributes:
        name: in words, with its endings, for a list.
        endings: of its files.
        open: source → set; None if the source is in another format.
        takes_deck: a JSON input of CB-Geo MPM may belong to it.
    """

    name: str
    endings: tuple[str, ...]
    open: Callable[[Source], ForeignSet | None]
    takes_deck: bool = False
