"""What `simulate.py -m …` ends with: a table of all its jobs, from the files that they wrote."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from gns_pl.scene.changes import decoded
from gns_pl.text import shown_path

JOB_FILE = "job.json"
COLUMNS = ("job", "changed", "time_s", "runout_m", "height_m", "file", "status")
"""Of the table: what the job changed; end of the run; advance of the front of 99 % of the mass along x, and height of
the highest particle over the floor, then."""


class SceneSweep(Callback):
    """Notes what every job of a sweep changed and wrote; a Hydra callback (conf/simulate.yaml)."""

    folder: ClassVar[Path | None] = None
    """Of the sweep that this process has started and not tabled yet."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Remember that a table is due."""
        SceneSweep.folder = Path(config.hydra.sweep.dir)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Leave in the job's folder what it changed, its files, or why it failed."""
        if config.hydra.mode != RunMode.MULTIRUN:
            return
        shared = set(config.hydra.job.config.override_dirname.exclude_keys)
        overrides = [override.lstrip("+").partition("=") for override in config.hydra.overrides.task]
        changes = [f"{_typed(key)}={value}" for key, _, value in overrides if key not in shared]
        done = job_return.status == JobStatus.COMPLETED
        result = job_return._return_value
        files = [str(Path(path).absolute()) for path in result or ()] if done else []
        content = {"changed": " ".join(changes), "files": files, "status": "done" if done else str(result)}
        (Path(config.hydra.runtime.output_dir) / JOB_FILE).write_text(json.dumps(content), encoding="utf-8")


def _typed(key: str) -> str:
    """Return the key of an override as it was typed."""
    return f"scene.{next(iter(decoded({key[8:]: 0})))}" if key.startswith("changes.") else key


@contextmanager
def sweep_tabled() -> Iterator[None]:
    """Print and write the table of a sweep that is started within, also if jobs failed."""
    try:
        yield
    finally:
        folder, SceneSweep.folder = SceneSweep.folder, None
        rows = [] if folder is None else read_rows(folder)
        if folder is not None and rows:
            show(rows)
            print("Made:", write_rows(folder / "sweep.csv", rows), sep="\n  ", flush=True)


def read_rows(folder: Path) -> list[dict[str, str]]:
    """Return a row for every file of a sweep, and for every job without one: name in `COLUMNS` → text.

    Args:
        folder: of the sweep, with a folder per job.
    """
    rows = []
    jobs = {int(path.parent.name): path for path in folder.glob(f"*/{JOB_FILE}") if path.parent.name.isdecimal()}
    for number in sorted(jobs):
        content = json.loads(jobs[number].read_text(encoding="utf-8"))
        shared = {"job": str(number), "changed": content["changed"], "status": content["status"]}
        rows += [{**shared, **measured(Path(file)), "file": shown_path(file)} for file in content["files"]] or [shared]
    return rows


def measured(path: Path) -> dict[str, str]:
    """Return how a trajectory ended, as text: time, runout, height and status."""
    import numpy as np

    from gns_pl.io import read_trajectory
    from gns_pl.metrics.curves import mobile
    from gns_pl.metrics.measures import particle_spacing, percentile_front

    flow = mobile(read_trajectory(path))
    distance = flow.position[[0, -1]].astype(np.float64) - np.array(flow.scene.lower)
    mass, spacing = flow.mass.astype(np.float64), particle_spacing(flow)
    front = percentile_front(distance[:, :, 0], mass, (99,), spacing)[0]
    height = percentile_front(distance[:, :, -1], mass, (100,), spacing)[0, -1]
    failed = flow.provenance.get("failure")
    numbers = {"time_s": flow.time[-1], "runout_m": front[-1] - front[0], "height_m": height}
    status = {"status": f"failed: {failed}"} if failed else {}
    return {name: f"{value:.4g}" for name, value in numbers.items()} | status


def write_rows(path: Path, rows: list[dict[str, str]]) -> Path:
    """Write the table as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)
    return path


def show(rows: list[dict[str, str]]) -> None:
    """Print the table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Sweep: end of every run", title_justify="left")
    for name in COLUMNS:
        table.add_column(name, justify="right" if name.endswith(("_s", "_m")) else "left", overflow="fold")
    for row in rows:
        table.add_row(*(row.get(name, "") for name in COLUMNS))
    console = Console()
    (console if console.is_terminal else Console(width=160)).print(table, markup=False)
