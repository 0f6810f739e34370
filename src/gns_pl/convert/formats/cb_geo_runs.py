"""Where the runs of CB-Geo MPM are below a folder, and which files each has.

A run is a folder with `particles<STEP>.h5`, with several ranks `particles-<rank>_<size>-<STEP>.h5`, packed by gzip or
not. It lies in the folder that was named or up to four below it: the authors have `SIM/results/UUID` beside the deck
in `SIM`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from gns_pl.convert.formats.series import even_step
from gns_pl.errors import InputError
from gns_pl.io import SPLITS

FILE = re.compile(r"particles(?:-(?P<rank>\d+)_(?P<size>\d+)-)?(?P<step>\d+)\.h5(?P<packed>\.gz)?")
DEEPEST = 4
"""Folders below a source in which runs are looked for."""
MOST_FOLDERS = 20_000


@dataclass(frozen=True)
class Run:
    """The files of a run.

    Attributes:
        folder: where they are.
        name: for messages.
        split: "train", "valid", "test" or "".
        steps: number of a saved step → its files, one a rank; rising.
        step: solver steps between saved ones; None where there is one saved step.
    """

    folder: Path
    name: str
    split: str
    steps: Mapping[int, tuple[Path, ...]]
    step: int | None


def find_runs(path: Path) -> list[Path]:
    """Return the folders of runs: a folder itself, or those below it; none if its own files are splits.

    Raises:
        InputError: a step of a run in the place of its folder, or more folders than a set has.
    """
    if FILE.fullmatch(path.name) and path.is_file():
        raise InputError(f"{path}: is one step of a run of CB-Geo MPM, if of any; name the folder of the run.")
    if not path.is_dir():
        return []
    left = [MOST_FOLDERS]
    found = sorted(_below(path, left, path))
    if found and left[0] < 0:
        raise InputError(f"{path}: has more than {MOST_FOLDERS:,} folders; name the one that holds the runs.")
    near = [folder for folder in found if len(folder.relative_to(path).parts) <= 1]
    if not near and any(file.stem in SPLITS and not file.is_dir() for file in path.iterdir()):
        return []  # a set that lies over the runs it was made from
    return found


def _below(folder: Path, left: list[int], root: Path) -> Iterator[Path]:
    left[0] -= 1
    if left[0] < 0:
        return
    entries = list(folder.iterdir())
    if any(FILE.fullmatch(entry.name) for entry in entries):
        yield folder
    elif len(folder.relative_to(root).parts) < DEEPEST:
        for entry in entries:
            if entry.is_dir() and not entry.name.startswith("."):
                yield from _below(entry, left, root)


def read_run(folder: Path, root: Path) -> Run:
    """Find the files of every step, each with all its ranks; of a file and its packed copy, the file.

    Args:
        folder: of the run.
        root: the source.

    Raises:
        InputError: ranks that are missing, or steps that do not follow evenly.
    """
    steps: dict[int, dict[int, Path]] = {}
    sizes: dict[int, set[int]] = {}
    for path in sorted(folder.iterdir()):  # x.h5 before x.h5.gz
        match = FILE.fullmatch(path.name)
        if match:
            rank, size, step = (int(match[key] or default) for key, default in (("rank", 0), ("size", 1), ("step", 0)))
            same = steps.setdefault(step, {}).setdefault(rank, path)
            sizes.setdefault(step, set()).add(size)
            if same.name.removesuffix(".gz") != path.name.removesuffix(".gz"):
                raise InputError(f"{folder}: {same.name} and {path.name} are of the same step; take one of them away.")
    for step, ranks in steps.items():
        if len(sizes[step]) != 1 or sorted(ranks) != list(range(next(iter(sizes[step])))):
            raise InputError(f"{folder}: step {step} lacks the files of some ranks, or has those of two runs.")
    numbers = sorted(steps)
    place = folder.relative_to(root)
    return Run(
        folder=folder,
        name=folder.absolute().name if folder == root else place.as_posix(),
        split=next((part for part in place.parts if part in SPLITS), ""),
        steps={step: tuple(steps[step][rank] for rank in sorted(steps[step])) for step in numbers},
        step=even_step(numbers, str(folder)),
    )
