"""What an evaluation refuses before anything heavy: checkpoints, folders and packages that are not there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.models.shipped import existing_checkpoint, find_corrector, is_corrector
from gns_pl.text import override


def named_checkpoints(wanted: Sequence[str]) -> dict[str, Path]:
    """Return a name for every checkpoint → its path: what was typed for one of the package's, else that of its folder.

    Raises:
        InputError: one that is not there.
    """
    paths: dict[str, Path] = {}
    for text in wanted:
        if is_corrector(text) and find_corrector(text).is_file():
            raise InputError(
                f"{text}: corrects coarse MPM and is no learned simulator, so it is not judged here: simulate.py "
                f"{override('ckpt', text)} runs it, and benchmark.py {override('ckpt', text)} measures it."
            )
        path = existing_checkpoint(text)
        if path in paths.values():
            continue
        name = text if path != Path(text) else path.parent.name or path.stem
        if name in paths:
            name = f"{name}_{path.stem}"
        if name in paths:
            name = f"{name}_{len(paths) + 1}"
        paths[name] = path
    return paths


def default_folder(wanted: str | Sequence[str], checkpoints: Mapping[str, Path]) -> Path:
    """Return where an evaluation goes if nobody says: beside one checkpoint; under runs/ for one of the package's."""
    if len(checkpoints) > 1:
        return Path("runs") / "_".join(checkpoints) / "evaluation"
    [(name, path)] = checkpoints.items()
    text = wanted if isinstance(wanted, str) else wanted[0]
    return (Path("runs") / name if path != Path(text) else path.parent) / "evaluation"


def check_figures(without: str = ", or go without: evaluation.figures=false") -> None:
    """Raise an `InputError` if the packages that draw are missing; it ends with how to do without."""
    from gns_pl.viz import missing_packages

    missing = missing_packages()
    if missing:
        raise InputError(f"figures need {' and '.join(missing)}: pip install 'gns_pl[viz]'{without}")


def check_space(*, film: bool) -> None:
    """Raise an `InputError` if the packages that draw in three dimensions are missing."""
    from importlib.util import find_spec

    missing = [name for name in ("pyvista", *(("imageio_ffmpeg",) if film else ())) if find_spec(name) is None]
    if missing:
        raise InputError(f"evaluation.film and paraview need {' and '.join(missing)}: pip install 'gns_pl[viz3d]'")


def make_folder(out: Path) -> None:
    """Make the folder for what an evaluation gives.

    Raises:
        InputError: it cannot be made or written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be created ({error.strerror}); choose another folder with out=…") from error
    if not os.access(out, os.W_OK):
        raise InputError(f"{out}: cannot be written; choose another folder with out=…")
