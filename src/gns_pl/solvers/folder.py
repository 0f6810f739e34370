"""The folder that runs write into: made, and written by one run at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.io import StorageError
from gns_pl.io.lock import locked
from gns_pl.scene import Scene


def prepare(out: Path, scenes: Sequence[Scene]) -> None:
    """Make the folder of scenes' files.

    Raises:
        InputError: two scenes of one name.
        StorageError: it cannot be made.
    """
    names = [scene.name for scene in scenes]
    if len(set(names)) < len(names):
        raise InputError(f"two scenes have the same name among {', '.join(names)}, and it names their files.")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{out}: cannot be made ({error.strerror}).") from error


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Be the only run that writes into a folder."""
    with locked(out / ".simulate.lock", on_wait=lambda: print(f"{out}: another run is writing here; waiting for it")):
        yield
