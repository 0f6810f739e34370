"""Going on with a run: be alone in its folder, find its checkpoint, and refuse one made with other settings."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.text import did_you_mean, override

DECISIVE = ("model", "data", "training", "seed", "callbacks.average", "trainer.precision", "trainer.gradient_clip_val")
"""What has to be the same for a resumed run to end where an uninterrupted one does."""

PLACES = ("data.root", "training.num_workers", "training.memory_limit")
"""Where and how, not what: these may change."""


def find_resume(resume: str | None, output: Path) -> Path | None:
    """Return the checkpoint to resume from: the one named, with "auto" the run's own `last.ckpt`, or none.

    Raises:
        InputError: the one named does not exist.
    """
    if resume is None:
        return None
    path = output / "last.ckpt" if resume == "auto" else Path(resume)
    if path.is_file():
        return path
    if resume != "auto":
        known = [str(file) for file in sorted(path.parent.glob("*.ckpt"))]
        raise InputError(f"resume={resume}: there is no such checkpoint{did_you_mean(resume, known)}.")
    return None


def steps_made(path: Path, settings: Mapping[str, Any]) -> int:
    """Return the steps a checkpoint's run has made, after making sure that `settings` may go on with it.

    Args:
        path: checkpoint of a run.
        settings: the resolved config of the run that would go on.

    Raises:
        InputError: not a checkpoint of ours, one without trainer state, or one made with other settings. If it is
            damaged, the newest good one beside it is named.
    """
    from gns_pl.models.checkpoint import KEY

    content = _read(path)
    if "optimizer_states" not in content:
        raise InputError(f"{path} holds no state of a training, so it cannot be resumed.")
    saved, now = (_flat(config) for config in (content[KEY]["provenance"]["config"], settings))
    for name in sorted(saved.keys() | now.keys()):
        decisive = any(name == group or name.startswith(f"{group}.") for group in DECISIVE)
        if decisive and name not in PLACES and saved.get(name) != now.get(name):
            raise InputError(
                f"{path} was made with {name}={saved.get(name)}, not {now.get(name)}, so it cannot be resumed; "
                "set it back, or train anew in another folder (hydra.run.dir=…)."
            )
    return int(content["global_step"])


def go_on(output: Path) -> str:
    """Return what to add to the command that began a run in order to go on with it."""
    return f"{override('resume', output / 'last.ckpt')} {override('hydra.run.dir', output)}"


@contextmanager
def exclusive(output: Path) -> Iterator[None]:
    """Claim the folder of a run for this process, and clear away what killed ones left half-written.

    Raises:
        InputError: another process is training there.
        StorageError: the disk refuses.
    """
    from gns_pl.io import StorageError, remove_temporary_files
    from gns_pl.io.lock import claim, open_lock

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{output}: cannot be written ({error.strerror}).") from error
    descriptor = open_lock(output / ".lock")
    try:
        try:
            # Loader processes must not inherit it, or they would keep it a while after a `kill -9`.
            if claim(descriptor, output / ".lock", wait=False, inherited=False):
                remove_temporary_files(output, "*.ckpt")
        except BlockingIOError as error:
            raise InputError(
                f"another train.py is at work in {output}; wait for it, or train in another folder (hydra.run.dir=…)."
            ) from error
        yield
    finally:
        os.close(descriptor)


def _read(path: Path) -> dict[str, Any]:
    """Return what a checkpoint holds.

    Raises:
        InputError: it cannot be read; the newest good one beside it is named.
    """
    from gns_pl.models.checkpoint import read_content
    from gns_pl.training.checkpoints import BEST, newest_first

    try:
        return read_content(path)
    except InputError as error:
        for other in (*newest_first(path.parent), path.parent / BEST):
            try:
                steps = read_content(other)["global_step"]
            except (InputError, KeyError):
                continue
            raise InputError(
                f"{str(error).rstrip('.')}; {other} is good and has made {steps} steps: to go on from there, add "
                f"{override('resume', other)} {override('hydra.run.dir', path.parent)}"
            ) from error
        raise InputError(
            f"{str(error).rstrip('.')}, and there is no good one beside it; resume=null trains anew."
        ) from error


def _flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested mapping with dotted names."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat
