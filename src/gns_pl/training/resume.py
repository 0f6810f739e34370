"""Going on with a run: find its checkpoint, and refuse one made with other settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError

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
        raise InputError(f"resume={resume}: there is no such checkpoint.")
    return None


def steps_made(path: Path, settings: Mapping[str, Any]) -> int:
    """Return the steps a checkpoint's run has made, after making sure that `settings` may go on with it.

    Args:
        path: checkpoint of a run.
        settings: the resolved config of the run that would go on.

    Raises:
        InputError: not a checkpoint of ours, one without trainer state, or one made with other settings.
    """
    from gns_pl.checkpoint import KEY, read_content

    content = read_content(path)
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


def _flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested mapping with dotted names."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat
