"""Checkpoints, correctors and fitted solvers that come with the package, each with a model card beside it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.text import did_you_mean

FOLDER = Path(__file__).parents[1] / "pretrained"

CORRECTOR = ".corrector"
"""Ending of the files that correct coarse MPM."""

CORRECTOR_KIND = "corrector"
"""model.kind of what corrects coarse MPM, in conf/model and in the checkpoints of its training."""

FITTED = ".yaml"
"""Ending of the files of solvers whose scalars were fitted."""


def pretrained_names() -> list[str]:
    """Return the names that can stand in the place of a checkpoint's path."""
    return sorted(path.stem for path in FOLDER.glob("*.ckpt"))


def corrector_names() -> list[str]:
    """Return the names that can stand in the place of a corrector's path."""
    return sorted(path.stem for path in FOLDER.glob(f"*{CORRECTOR}"))


def find_checkpoint(path: str | Path) -> Path:
    """Return the path of a checkpoint: that of a model of the package if its bare name is given."""
    return FOLDER / f"{path}.ckpt" if str(path) in pretrained_names() and not Path(path).is_file() else Path(path)


def find_corrector(path: str | Path) -> Path:
    """Return the path of a corrector: that of one that comes with the package if its bare name is given."""
    shipped = FOLDER / f"{path}{CORRECTOR}"
    return shipped if shipped.is_file() and not Path(path).is_file() else Path(path)


def fitted_names() -> list[str]:
    """Return the names of the solvers with fitted scalars that come with the package."""
    return sorted(path.stem for path in FOLDER.glob(f"*{FITTED}"))


def find_fitted(path: str | Path) -> Path:
    """Return the path of a fitted solver: that of one that comes with the package if its bare name is given."""
    shipped = FOLDER / f"{path}{FITTED}"
    return shipped if shipped.is_file() and not Path(path).exists() else Path(path)


def is_fitted(path: str | Path) -> bool:
    """Return whether a name or a file is a fitted solver."""
    return find_fitted(path).suffix == FITTED


def is_corrector(path: str | Path) -> bool:
    """Return whether a name or a file is a corrector and no checkpoint."""
    return find_corrector(path).suffix == CORRECTOR


def existing_checkpoint(path: str | Path, also: Iterable[str] = ()) -> Path:
    """Return the path of a checkpoint that is there.

    Args:
        path: as of `find_checkpoint`.
        also: names of what can stand in its place besides, for the message.

    Raises:
        InputError: there is none; names that may have been meant, and those that come with the package, are told.
    """
    file = find_checkpoint(path)
    if file.is_file():
        return file
    known = sorted([*pretrained_names(), *also])
    beside = [str(checkpoint) for checkpoint in sorted(file.parent.glob("*.ckpt"))]
    raise InputError(
        f"{path}: there is no such checkpoint{did_you_mean(str(path), [*known, *beside])}; "
        f"those that come with gns_pl are {', '.join(known)}."
    )
