"""What a sweep ends with: one table and one figure over all its jobs, whatever became of each of them.

`SweepReport` is a Hydra callback (conf/train.yaml), so it works for every `python train.py -m …`, with or without a
file of conf/sweep, and with every launcher: all it needs from a job is the folder that the job leaves. Nothing heavy
is imported here, since Hydra does so before anything runs; the jobs of other processes also find here the resolvers
that name their folder, their W&B run and its group.
"""

from __future__ import annotations

import multiprocessing
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode, TaskFunction
from omegaconf import DictConfig, OmegaConf

from gns_pl.errors import tolerated
from gns_pl.training.summary import FAILURE_FILE

LONGEST_NAME = 120


def shortened(text: str) -> str:
    """Return a text in the characters and at a length that folders and `ckpt=…` can take."""
    return re.sub(r"[^\w.+-]+", "_", str(text))[:LONGEST_NAME]


def group_name(directory: str) -> str:
    """Return the W&B group of a sweep from its folder, `runs/NAME/TIME`: the last two parts."""
    return shortened("_".join(Path(directory).parts[-2:]))


def _sweep_group() -> str | None:
    """Return the group of the job that is running, None if it belongs to no sweep."""
    hydra = HydraConfig.get()
    return group_name(hydra.sweep.dir) if hydra.mode == RunMode.MULTIRUN else None


def _run_name(name: str) -> str:
    """Return the name of the W&B run of the job that is running: in a sweep it tells the jobs apart."""
    hydra = HydraConfig.get()
    job = Path(str(hydra.runtime.output_dir)).name
    return f"{name} {job}"[:LONGEST_NAME] if hydra.mode == RunMode.MULTIRUN else name


OmegaConf.register_new_resolver("shortened", shortened, replace=True)
OmegaConf.register_new_resolver("sweep_group", _sweep_group, replace=True)
OmegaConf.register_new_resolver("run_name", _run_name, replace=True)


class SweepReport(Callback):
    """Notes which jobs fail, and reports when all are done.

    Hydra calls `on_multirun_end` only if no job failed, so `sweep_reported` around the command does the rest.
    """

    open_sweep: ClassVar[DictConfig | None] = None
    """Config of the sweep that this process has started and not reported yet."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Remember that a report is due."""
        SweepReport.open_sweep = config

    def on_job_start(self, config: DictConfig, *, task_function: TaskFunction, **kwargs: Any) -> None:
        """Forget an earlier failure of a job that is tried again, and let a worker of joblib have child processes.

        Joblib leaves its own way of starting processes as the default in its workers, which children that are spawned
        (the MPM's, the data loader's) do not know.
        """
        _failure_file(config).unlink(missing_ok=True)
        if multiprocessing.get_start_method(allow_none=True) not in (None, *multiprocessing.get_all_start_methods()):
            multiprocessing.set_start_method(None, force=True)  # back to the system's

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Leave the reason of a failure in the job's folder."""
        if config.hydra.mode == RunMode.MULTIRUN and job_return.status == JobStatus.FAILED:
            error = job_return._return_value
            _failure_file(config).write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Report."""
        close_sweep()


@contextmanager
def sweep_reported() -> Iterator[None]:
    """Report a sweep started within, also if jobs failed, a worker was killed or the user stopped it."""
    try:
        yield
    finally:
        close_sweep()


def close_sweep() -> None:
    """Report the sweep that is open, if one is."""
    config, SweepReport.open_sweep = SweepReport.open_sweep, None
    if config is None:
        return
    try:
        logger = OmegaConf.select(config, "logger.wandb")
        tracking: dict[str, Any] | None = None
        if logger is not None:
            settings = {key: logger.get(key) for key in ("project", "entity", "tags", "notes")}
            tracking = {
                key: list(value) if OmegaConf.is_list(value) else value for key, value in settings.items() if value
            }
            tracking["offline"] = bool(config.logger.offline)
        report_sweep(Path(config.hydra.sweep.dir), name=str(config.name), tracking=tracking)
    except Exception as error:  # the trainings are done, and what went wrong with the jobs is to be told after this
        print(f"train.py: the sweep's report failed: {type(error).__name__}: {error}", file=sys.stderr)


def report_sweep(folder: Path, *, name: str, tracking: dict[str, Any] | None) -> list[Path]:
    """Write sweep.csv and sweep.md, draw sweep.png and sweep.pdf, print the table and log all to W&B.

    Args:
        folder: of the sweep, with a folder per job.
        name: of the experiment.
        tracking: {project, offline, …} of W&B, as `tracking.started` takes them; None logs nothing.

    Returns:
        Paths of what was made; none if no job was started.
    """
    from gns_pl.training.sweep_table import read_jobs, show, write_tables
    from gns_pl.viz import missing_packages

    jobs = read_jobs(folder)
    if not jobs:
        return []
    files = write_tables(jobs, folder, name)
    if missing_packages():
        print(f"No figure of the sweep: it needs {' and '.join(missing_packages())} (pip install 'gns_pl[viz]').")
    else:
        with tolerated("the figure of the sweep"):
            files += draw_sweep(jobs, folder)
    show(jobs, name)
    if tracking is not None:
        from gns_pl.training.sweep_tracking import log_sweep

        with tolerated("the sweep's run of W&B"):
            files += log_sweep(jobs, files, folder=folder, group=group_name(str(folder)), **tracking)
    print("Made:", *files, sep="\n  ", flush=True)
    return files


def draw_sweep(jobs: list[Any], folder: Path) -> list[Path]:
    """Draw errors and step times over the first of the swept parameters, one line per value of the others."""
    from gns_pl.training.sweep_table import PANELS, SEED, sweep_points, swept_names
    from gns_pl.viz import plot_sweep

    points = sweep_points(jobs)
    if not points:
        return []
    files = [folder / "sweep.png", folder / "sweep.pdf"]
    swept = [parameter for parameter in swept_names(jobs) if parameter != SEED]
    panels = {name: label for name, label in PANELS.items() if any(name in point.values for point in points)}
    plot_sweep(points, panels, swept[0] if swept else "", files)
    return files


def _failure_file(config: DictConfig) -> Path:
    return Path(config.hydra.runtime.output_dir) / FAILURE_FILE
