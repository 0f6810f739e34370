"""A sweep's table and figure as one more W&B run in the group of its jobs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gns_pl.io.tracking import started, unless_disabled
from gns_pl.training.sweep_table import SEED, Job, by_setting, measured, over_seeds, swept_names


@unless_disabled
def log_sweep(
    jobs: Sequence[Job], files: Sequence[Path], *, folder: Path, group: str, project: str, offline: bool, **more: Any
) -> Path:
    """Log the table, the figure and what came of every setting, and close the run whatever happens.

    Args:
        jobs: of the sweep.
        files: what was made; PNG files are logged.
        folder: under which W&B puts its own folder.
        group: of the jobs' runs.
        project: W&B project.
        offline: keep the run on this disk.
        **more: of `wandb.init`: entity, tags, notes.

    Returns:
        Folder of the run.

    Raises:
        InputError: W&B refuses to start.
    """
    import wandb

    given = {"out": folder, "offline": offline, "project": project, "group": group, "name": group, **more}
    with started("sweep", {}, **given) as run:
        swept, names = swept_names(jobs), list(measured(jobs[0]))
        table = wandb.Table(columns=["job", *swept, "status", *names])
        for job in jobs:
            values = measured(job)
            numbers: list[Any] = [None if values[name] is None else float(values[name] or 0.0) for name in names]
            table.add_data(job.folder.name, *(job.parameters.get(name, "") for name in swept), job.status, *numbers)
        images = {path.stem: wandb.Image(str(path)) for path in files if path.suffix == ".png"}
        run.log({"jobs": table, **{f"{name}_figure": image for name, image in images.items()}})
        swept = [name for name in swept if name != SEED]
        for setting, some in by_setting(jobs).items():
            label = ",".join(f"{name}={value}" for name, value in zip(swept, setting, strict=True)) or "all"
            for name, (mean, std) in over_seeds(some).items():
                run.summary.update({f"{label}/{name}": mean, f"{label}/{name}_std": std})
        run.summary.update({"num_jobs": len(jobs), "num_failed": sum(job.status == "failed" for job in jobs)})
        return Path(run.dir).parent
