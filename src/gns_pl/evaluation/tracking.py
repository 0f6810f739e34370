"""An evaluation as a W&B run, offline unless asked otherwise: no account is ever needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError

if TYPE_CHECKING:
    from gns_pl.evaluation.stress.runs import Row


def log_evaluation(
    document: Mapping[str, Any], files: Sequence[Path], *, out: Path, offline: bool, project: str
) -> Path:
    """Log tables, images, animations and the summary, and close the run whatever happens.

    Args:
        document: the content of metrics.json.
        files: what was made; PNG and GIF files are logged.
        out: folder under which W&B puts its own folder.
        offline: keep the run on this disk.
        project: W&B project.

    Returns:
        Folder of the run.

    Raises:
        InputError: W&B refuses to start, as it does online without an account. The results are on disk by then.
    """
    import wandb

    run = _started(out, config=document["checkpoint"], offline=offline, project=project)
    try:
        folder = Path(run.dir).parent
        media = _images(files)
        media |= {f"animation_{file.stem}": wandb.Video(str(file)) for file in files if file.suffix in (".gif", ".mp4")}
        run.log(media | {"metrics": _table(wandb, document)})
        for name, scene in document["scenes"].items():
            for group in ("learned", "reference", "wall_seconds"):
                run.summary.update({f"{name}/{group}/{key}": value for key, value in scene[group].items()})
            errors = scene["errors"]["learned"]
            run.summary.update({f"{name}/errors/{key}": value for key, value in errors.items()})
            run.summary.update({f"{name}/failed_at": scene["failed_at"]})
            run.summary.update(
                {f"{name}/familiarity/{key}": value for key, value in (scene["familiarity"] or {}).items()}
            )
    finally:
        wandb.finish()
    return folder


def log_stress(rows: Sequence[Row], files: Sequence[Path], *, out: Path, offline: bool, project: str) -> Path:
    """Log the rows of the stress suite and its figure; arguments and errors as `log_evaluation`.

    Args:
        rows: what became of the scenes.
        files: what was made; PNG files are logged.
        out: as there.
        offline: as there.
        project: as there.
    """
    import wandb

    run = _started(out, config={"models": sorted({row.model for row in rows})}, offline=offline, project=project)
    try:
        folder = Path(run.dir).parent
        table = wandb.Table(columns=list(asdict(rows[0])), data=[list(asdict(row).values()) for row in rows])
        run.log(_images(files) | {"stress": table})
        for model in dict.fromkeys(row.model for row in rows):
            failed = [row for row in rows if row.model == model and row.kind]
            run.summary.update(
                {f"{model}/failed": len(failed), f"{model}/failed_inside": sum(r.inside for r in failed)}
            )
    finally:
        wandb.finish()
    return folder


def _started(out: Path, *, config: Mapping[str, Any], offline: bool, project: str) -> Any:
    import wandb

    try:
        return wandb.init(
            project=project,
            job_type="evaluation",
            dir=str(out),
            mode="offline" if offline else "online",
            config=dict(config),
            settings=wandb.Settings(silent=True, console="off"),
        )
    except wandb.errors.Error as error:
        raise InputError(
            f"W&B could not start ({error}); the results are in {out}, and logger.offline=true needs no account."
        ) from error


def _images(files: Sequence[Path]) -> dict[str, Any]:
    import wandb

    return {file.stem: wandb.Image(str(file)) for file in files if file.suffix == ".png"}


def _table(wandb: Any, document: Mapping[str, Any]) -> Any:
    table = wandb.Table(columns=["scene", "quantity", "reference", "spread", "learned", "no_motion"])
    for name, scene in document["scenes"].items():
        for key in scene["reference"]:
            own = scene["reference_spread"].get(key)
            table.add_data(name, key, scene["reference"][key], own, scene["learned"][key], scene["no_motion"][key])
        for key, value in scene["errors"]["learned"].items():
            own = scene["reference_spread"].get(key)
            table.add_data(name, key, None, own, value, scene["errors"]["no_motion"][key])
    return table
