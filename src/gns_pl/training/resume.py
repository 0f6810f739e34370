"""Going on with a run: find its checkpoint, and refuse one made with other settings."""

from __future__ import annotations

from pathlib import Path

from gns_pl.errors import InputError


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


def check_resume(path: Path, settings: dict[str, object]) -> None:
    """Raise an `InputError` if a checkpoint was made with other hyperparameters than `settings`."""
    import torch

    saved = torch.load(path, map_location="cpu", weights_only=True).get("hyper_parameters", {})
    for group in ("model", "data", "optimisation", "perturbation", "seed"):
        if saved.get(group) != settings[group]:
            raise InputError(
                f"{path} was made with other settings ({group} differs), so it cannot be resumed; "
                "give this run another folder (hydra.run.dir=…) or delete that one."
            )
