"""An evaluation, or a chart, as a W&B run, offline unless asked otherwise: no account is ever needed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.io.tracking import started, unless_disabled

if TYPE_CHECKING:
    from gns_pl.evaluation.stress.runs import Row


@unless_disabled
def log_evaluation(
    document: Mapping[str, Any], files: Sequence[Path], *, out: Path, offline: bool, project: str, **more: Any
) -> Path:
    """Log tables, images, animations and the summary, and close the run whatever happens.

    Args:
        document: the content of metrics.json.
        files: what was made; PNG and GIF files are logged.
        out: folder under which W&B puts its own folder.
        offline: keep the run on this disk.
        project: W&B project.
        **more: of `wandb.init`: entity, tags, notes.

    Returns:
        Folder of the run.

    Raises:
        InputError: W&B refuses to start, as it does online without an account. The results are on disk by then.
    """
    import wandb

    with started("evaluation", dict(document["checkpoint"]), out=out, offline=offline, project=project, **more) as run:
        media: dict[str, Any] = {file.stem: wandb.Image(str(file)) for file in files if file.suffix == ".png"}
        media |= {f"animation_{file.stem}": wandb.Video(str(file)) for file in files if file.suffix in (".gif", ".mp4")}
        run.log(media | {"metrics": _table(wandb, document)})
        for name, scene in document["scenes"].items():
            for group in ("learned", "reference", "wall_seconds"):
                run.summary.update({f"{name}/{group}/{key}": value for key, value in scene[group].items()})
            errors = scene["errors"]["learned"]
            run.summary.update({f"{name}/errors/{key}": value for key, value in errors.items()})
            run.summary.update({f"{name}/std/{key}": value for key, value in scene["placements"]["std"].items()})
            run.summary.update({f"{name}/failed_at": scene["failed_at"]})
            run.summary.update({f"{name}/ood/{key}": value for key, value in (scene["ood"] or {}).items()})
        return Path(run.dir).parent


@unless_disabled
def log_chart(
    points: Sequence[Any],
    figure: Path,
    caption: str,
    *,
    command: str,
    out: Path,
    offline: bool,
    project: str,
    **more: Any,
) -> Path:
    """Log a chart of speed against accuracy: figure, table of points, and time and error of each in the summary.

    Args:
        points: `chart.points.Point`.
        figure: PNG.
        caption: of the figure.
        command: by which it was measured.
        out: as of `log_evaluation`, like the next two.
        offline: likewise.
        project: likewise.
        **more: likewise.

    Returns:
        Folder of the run.

    Raises:
        InputError: W&B refuses to start.
    """
    import wandb

    with started("benchmark", {"command": command}, out=out, offline=offline, project=project, **more) as run:
        names = [point.name for point in fields(points[0])]
        table = wandb.Table(columns=names, data=[[_finite(getattr(point, name)) for name in names] for point in points])
        run.log({"chart": wandb.Image(str(figure), caption=caption), "points": table})
        for point in points:
            run.summary.update({f"{point.name}/{key}": _finite(getattr(point, key)) for key in ("seconds", "error")})
        return Path(run.dir).parent


@unless_disabled
def log_stress(
    rows: Sequence[Row], files: Sequence[Path], *, out: Path, offline: bool, project: str, **more: Any
) -> Path:
    """Log the rows of the stress suite and its figure; the rest as `log_evaluation`.

    Args:
        rows: what became of the scenes.
        files: what was made; PNG files are logged.
        out: as there, like the next two.
        offline: likewise.
        project: likewise.
        **more: likewise.

    Returns:
        Folder of the run.

    Raises:
        InputError: W&B refuses to start.
    """
    import wandb

    models = list(dict.fromkeys(row.model for row in rows))
    with started("stress", {"models": models}, out=out, offline=offline, project=project, **more) as run:
        table = wandb.Table(columns=list(asdict(rows[0])), data=[list(asdict(row).values()) for row in rows])
        media = {file.stem: wandb.Image(str(file)) for file in files if file.suffix == ".png"}
        run.log(media | {"table": table})
        for model in models:
            failed = [row for row in rows if row.model == model and row.kind]
            inside = sum(row.inside for row in failed)
            run.summary.update({f"{model}/failed": len(failed), f"{model}/failed_inside": inside})
        return Path(run.dir).parent


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _table(wandb: Any, document: Mapping[str, Any]) -> Any:
    table = wandb.Table(columns=["scene", "quantity", "reference", "spread", "learned", "learned_std", "no_motion"])
    for name, scene in document["scenes"].items():
        own, std, errors = scene["reference_spread"], scene["placements"]["std"], scene["errors"]
        for key, value in scene["reference"].items():
            learned, still = scene["learned"][key], scene["no_motion"][key]
            table.add_data(name, key, value, own.get(key), learned, std.get(key), still)
        for key, value in errors["learned"].items():
            table.add_data(name, key, None, own.get(key), value, std.get(key), errors["no_motion"][key])
    return table
