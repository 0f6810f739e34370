"""What an evaluation refuses before anything heavy: checkpoints, folders and packages that are not there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gns_pl.errors import InputError
from gns_pl.models.shipped import existing_checkpoint, find_corrector, is_corrector
from gns_pl.text import override

if TYPE_CHECKING:
    from gns_pl.models.checkpoint import Checkpoint


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


def with_data(checkpoint: Checkpoint, root: str) -> Checkpoint:
    """Return the checkpoint with the folder in which its data lie now; data of another training are told.

    Raises:
        InputError: no data there.
    """
    from gns_pl.evaluation.references import stored_folder
    from gns_pl.io import manifest_sha256

    checkpoint = replace(checkpoint, data={**checkpoint.data, "root": root})
    folder, trained = stored_folder(checkpoint.data), checkpoint.provenance.get("manifest_sha256")
    if trained is not None and manifest_sha256(folder) != trained:
        print(f"{folder}: not the data that this checkpoint was trained on (their manifests differ).")
    return checkpoint


def imported_split(checkpoint: Checkpoint, path: Path, *, wants_scenes: bool) -> str:
    """Return the split that speaks for imported data, which no solver of ours made: "test", or "valid" without tests.

    Args:
        checkpoint: what is evaluated.
        path: of it, for messages.
        wants_scenes: scenes were named.

    Raises:
        InputError: scenes, or data that are not there.
    """
    from gns_pl.evaluation.references import stored_folder
    from gns_pl.io import read_manifest

    if wants_scenes or "root" not in checkpoint.data:
        raise InputError(
            f"{path}: its data do not say by which MPM they were made, so nothing can be computed to compare with; "
            "name trajectories of its data: data.root=FOLDER evaluation.split=test"
        )
    splits = read_manifest(stored_folder(checkpoint.data)).splits
    split = "test" if splits["test"] else "valid"
    print(f"Its data are imported, so it is judged on their {split} trajectories (evaluation.split={split}).")
    return split
