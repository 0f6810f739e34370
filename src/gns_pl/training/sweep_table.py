"""The jobs of a sweep as rows: read from their folders, put together over seeds, written, printed, made into points."""

from __future__ import annotations

import csv
import io
import math
import re
import statistics
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from gns_pl.io.atomic import write_atomically
from gns_pl.text import number, percent
from gns_pl.training.summary import FAILURE_FILE, SUMMARY_FILE, read_summary
from gns_pl.training.validation import DEPOSIT, DEPOSIT_ERROR
from gns_pl.viz import SweepPoint

PANELS = {
    "position_error": "best rollout position error [spacings]",
    "runout_99_error_percent": "its final runout error [%]",
    "deposit_error_percent": "its deposits, worse of front and map [%]",
    "height_rms_percent": "their mean height [%]",
    "step_ms": "training step [ms]",
    "rollout_step_ms": "rollout step [ms]",
}
"""Panels of the figure, each where a job knows its value: key of `measured` → label."""

COLUMNS = {
    "steps": "steps",
    "position_error": "error [spacing]",
    "at_step": "at step",
    "runout_99_error": "runout",
    "mean_height_error": "mean height",
    "front_rms_percent": "deposits: front [%]",
    "map_rms_percent": "map [%]",
    "height_rms_percent": "height [%]",
    "speed_mean": "speed at the end [m/s]",
    "step_ms": "step [ms]",
    "rollout_step_ms": "rollout step [ms]",
    "hours": "hours",
}
"""Columns of sweep.md, each where a job knows its value: key of `measured` → title."""

NOT_PRINTED = ("steps", "at step", "mean height", "height [%]", "speed at the end [m/s]")
"""Columns of sweep.md that are not printed."""

DEPOSIT_ERRORS = (DEPOSIT_ERROR, *(f"{name}_rms" for name in DEPOSIT))

SEED = "seed"
"""Jobs that differ in it alone are repetitions of each other."""


@dataclass(frozen=True)
class Job:
    """What one job left.

    Attributes:
        folder: its folder.
        parameters: overridden key → value as text, in the order in which they were given.
        status: "finished", "stopped", "failed", or "unfinished" if it was killed or is running still.
        error: why it failed; "" otherwise.
        summary: its summary.json, None if there is none.
    """

    folder: Path
    parameters: dict[str, str]
    status: str
    error: str
    summary: dict[str, Any] | None


def read_jobs(folder: Path) -> list[Job]:
    """Return the jobs of a sweep's folder by their numbers."""
    folders = [path.parents[1] for path in folder.glob("*/.hydra/overrides.yaml")]
    return [_read_job(path) for path in sorted(folders, key=lambda path: (_leading_number(path.name), path.name))]


def _leading_number(name: str) -> float:
    matched = re.match(r"\d+", name)
    return int(matched.group()) if matched else math.inf


def _read_job(folder: Path) -> Job:
    overrides = yaml.safe_load((folder / ".hydra" / "overrides.yaml").read_text(encoding="utf-8")) or []
    pairs = [str(override).partition("=") for override in overrides if "=" in str(override)]
    parameters = {key.lstrip("+~"): value for key, _, value in pairs}
    summary, failure = read_summary(folder), folder / FAILURE_FILE
    # The number of trajectories that "all of them" are is known to the job alone.
    if summary is not None and parameters.get("training.num_train") == "null":
        parameters["training.num_train"] = str(summary["data"]["num_train"])
    if failure.is_file():
        return Job(folder, parameters, "failed", failure.read_text(encoding="utf-8").strip(), summary)
    return Job(folder, parameters, "unfinished" if summary is None else summary["status"], "", summary)


def swept_names(jobs: Sequence[Job]) -> list[str]:
    """Return the parameters that differ between the jobs, in the order in which they were given."""
    names = list(dict.fromkeys(name for job in jobs for name in job.parameters))
    return [name for name in names if len({job.parameters.get(name) for job in jobs}) > 1]


def measured(job: Job) -> dict[str, float | None]:
    """Return the numbers of a job's row; None is not known. Errors are those of the validation with the best rollout.

    A failed job has none: what it left may be of an earlier start.
    """
    summary = job.summary if job.summary is not None and job.status != "failed" else {}
    best, final = summary.get("best") or {}, summary.get("final") or {}
    relative = {name: best.get(name) for name in ("runout_99_error", *DEPOSIT_ERRORS)}
    return {
        "steps": summary.get("steps"),
        "position_error": best.get("position_error"),
        "at_step": best.get("step"),
        **relative,
        **{f"{name}_percent": None if value is None else 100 * value for name, value in relative.items()},
        "mean_height_error": best.get("mean_height_error"),
        "speed_mean": best.get("speed_mean"),
        "final_position_error": final.get("position_error"),
        "step_ms": _milli(summary.get("step_seconds")),
        "rollout_step_ms": _milli(summary.get("rollout_step_seconds")),
        "windows_per_s": summary.get("windows_per_s"),
        "hours": None if summary.get("wall_seconds") is None else summary["wall_seconds"] / 3600,
        "num_parameters": summary.get("num_parameters"),
        "num_threads": summary.get("num_threads"),
    }


def _milli(seconds: float | None) -> float | None:
    return None if seconds is None else 1000 * seconds


def sweep_points(jobs: Sequence[Job]) -> list[SweepPoint]:
    """Return the jobs that have something to show: x is the first swept parameter, the line tells the others."""
    swept = [name for name in swept_names(jobs) if name != SEED]
    points = []
    for job in jobs:
        values = {name: value for name, value in measured(job).items() if value is not None}
        if PANELS.keys() & values.keys():
            x = _as_number(job.parameters.get(swept[0], "default")) if swept else "all seeds"
            line = ", ".join(f"{name.split('.')[-1]} = {job.parameters.get(name, 'default')}" for name in swept[1:])
            points.append(SweepPoint(x, line, values))
    if any(isinstance(point.x, str) for point in points):  # numbers and words together are words
        return [SweepPoint(f"{p.x:g}" if isinstance(p.x, float) else p.x, p.line, p.values) for p in points]
    return points


def _as_number(text: str) -> float | str:
    try:
        value = float(text)
    except ValueError:
        return text
    return value if math.isfinite(value) else text


def write_tables(jobs: Sequence[Job], folder: Path, name: str) -> list[Path]:
    """Write sweep.csv, with every number in full, and sweep.md; return their paths."""
    swept = swept_names(jobs)
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    numbers = [key for key in measured(jobs[0]) if not key.endswith("_percent")]
    writer.writerow(["job", *swept, "status", *numbers, "error", "folder"])
    for job in jobs:
        values = measured(job)
        row = ["" if values[key] is None else values[key] for key in numbers]
        parameters = [job.parameters.get(key, "") for key in swept]
        writer.writerow([job.folder.name.split("-")[0], *parameters, job.status, *row, job.error, job.folder.name])
    table, page = folder / "sweep.csv", folder / "sweep.md"
    write_atomically(table, text.getvalue().encode())
    tables = "\n\n".join(_markdown(rows) for rows in shown_tables(jobs))
    failures = "".join(f"- job {job.folder.name}: {job.error}\n" for job in jobs if job.error)
    note = (
        f"Errors are those of the best validation of each job (`best` in its {SUMMARY_FILE}), over whole rollouts "
        "from the first frame; step times are medians. Over seeds: mean ± standard deviation.\n"
    )
    write_atomically(page, f"# Sweep of {name}\n\n{tables}\n\n{note}\n{failures}".encode())
    return [table, page]


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    header, *others = rows
    lines = [header, ["---"] * len(header), *others]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def shown_tables(jobs: Sequence[Job]) -> list[list[list[str]]]:
    """Return the tables for people: the means over seeds, where a setting has several, and all jobs."""
    repeated = any(len(some) > 1 for some in by_setting(jobs).values())
    return [*([mean_rows(jobs)] if repeated else []), table_rows(jobs)]


def by_setting(jobs: Sequence[Job]) -> dict[tuple[str, ...], list[Job]]:
    """Return the jobs by the values of what was swept, seeds left out, in the order in which they were made."""
    swept = [name for name in swept_names(jobs) if name != SEED]
    settings: dict[tuple[str, ...], list[Job]] = defaultdict(list)
    for job in jobs:
        settings[tuple(job.parameters.get(name, "default") for name in swept)].append(job)
    return settings


def over_seeds(jobs: Sequence[Job]) -> dict[str, tuple[float, float | None]]:
    """Return what the jobs that have finished know: name → mean and sample standard deviation, None of one value."""
    known: dict[str, list[float]] = defaultdict(list)
    for job in jobs:
        for name, value in measured(job).items() if job.status == "finished" else ():
            if value is not None:
                known[name].append(float(value))
    return {name: (statistics.mean(some), _deviation(some)) for name, some in known.items()}


def _deviation(values: Sequence[float]) -> float | None:
    return statistics.stdev(values) if len(values) > 1 else None


def mean_rows(jobs: Sequence[Job]) -> list[list[str]]:
    """Return header and rows of the settings, with mean and standard deviation over the seeds that have finished."""
    columns, rows = _columns(jobs), list[list[str]]()
    for setting, some in by_setting(jobs).items():
        known, finished = over_seeds(some), sum(job.status == "finished" for job in some)
        cells = [_cell(name, *known.get(name, (None, None))) for name in columns]
        rows.append([*setting, f"{finished} of {len(some)}", *cells])
    header = [*(name for name in swept_names(jobs) if name != SEED), "seeds", *(COLUMNS[name] for name in columns)]
    return [header, *rows]


def table_rows(jobs: Sequence[Job]) -> list[list[str]]:
    """Return header and rows of the jobs."""
    swept, columns = swept_names(jobs), _columns(jobs)
    rows = [["job", *swept, "status", *(COLUMNS[name] for name in columns)]]
    for job in jobs:
        parameters = [job.parameters.get(key, "default") for key in swept]
        cells = [_cell(name, measured(job)[name]) for name in columns]
        rows.append([job.folder.name.split("-")[0], *parameters, job.status, *cells])
    return rows


def _columns(jobs: Sequence[Job]) -> list[str]:
    """Return the names of `COLUMNS` that some job knows."""
    values = [measured(job) for job in jobs]
    return [name for name in COLUMNS if any(each[name] is not None for each in values)]


def _cell(name: str, value: float | None, std: float | None = None) -> str:
    if value is not None and name in ("steps", "at_step"):
        return f"{value:,.0f}"
    return (percent(value, std) or "–") if name in ("runout_99_error", "mean_height_error") else number(value, std)


def show(jobs: Sequence[Job], name: str) -> None:
    """Print the tables without what a terminal has no room for, and the reasons of failures below them."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    for header, *rows in shown_tables(jobs):
        shown = [place for place, title in enumerate(header) if title not in NOT_PRINTED]
        table = Table(title=f"Sweep of {name}", box=SIMPLE, padding=(0, 1, 0, 0))
        for place in shown:
            title = header[place].split(".")[-1].replace("_", " ")  # a header breaks between words
            table.add_column(title, justify="right", overflow="fold", min_width=max(len(row[place]) for row in rows))
        for row in rows:
            table.add_row(*(row[place] for place in shown))
        console.print(table)
    for job in jobs:
        if job.error:
            console.print(f"job {job.folder.name} failed: {job.error}", soft_wrap=True)
