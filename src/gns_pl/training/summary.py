"""summary.json, which every training leaves in its folder, and the same in words. Nothing heavy is imported here."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

from gns_pl.models.shipped import is_corrector
from gns_pl.text import command, override, shown_path
from gns_pl.training.validation import DEPOSIT

FORMAT = "gns_pl training summary"
FORMAT_VERSION = 1
SUMMARY_FILE = "summary.json"
FAILURE_FILE = "failed.txt"
"""In the folder of a sweep's job: why it failed."""


def read_summary(run: Path) -> dict[str, Any] | None:
    """Return the summary in a run's folder, None if there is none that can be read."""
    try:
        content: dict[str, Any] = json.loads((run / SUMMARY_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if content.get("format") == FORMAT else None


def objective(run: Path) -> float | None:
    """Return the error of a run's best validation that sweepers such as Optuna make smaller: the one it was chosen by.

    For simulators that is the position error [spacings]. It is infinite if no rollout was finite, and None for a run
    without a validation.
    """
    summary = read_summary(run)
    if summary is None or summary["final"] is None:
        return None
    error = (summary["best"] or {}).get(summary.get("monitor", "position_error"))
    return math.inf if error is None else float(error)


def headline(summary: Mapping[str, Any]) -> str:
    """Return steps and time in one phrase."""
    wall = summary["wall_seconds"]
    time = "" if wall is None else f" in {timedelta(seconds=round(wall))}"
    starts = f", {summary['num_starts']} starts" if summary["num_starts"] > 1 else ""
    return f"{summary['steps']:,} of {summary['num_steps']:,} steps{time}{starts}"


def summary_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return summary.json in words, with the command that judges the best checkpoint."""
    data = summary["data"]
    lines = [
        f"{summary['name']}: {summary['status']}, {headline(summary)}",
        f"  data        {data['name']}: {data['num_windows']:,} windows of {data['num_train']} trajectories, "
        f"{data['num_valid']} for validation",
        f"  network     {summary['num_parameters']:,} parameters",
    ]
    threads = f", {summary['num_threads']} thread{'s' if summary['num_threads'] > 1 else ''}"
    device = summary["device"] + (threads if summary["device"] == "cpu" else "")
    paces = [
        (summary["step_seconds"], 1e3, "ms a step"),
        (summary["windows_per_s"], 1, "windows/s"),
        (summary["rollout_step_seconds"], 1e3, "ms a step of a rollout"),
    ]
    known = [f"{value * factor:.3g} {unit}" for value, factor, unit in paces if value is not None]
    lines.append(f"  pace        {', '.join(known) or 'not measured'} on {device}")
    if "rollouts" in summary:
        runs = summary["rollouts"]
        pace = "" if runs["step_seconds"] is None else f", {runs['step_seconds']:.3g} s each"
        left = f"{runs['skipped']} left out, not finite" if runs["skipped"] else "none left out"
        lines.append(f"  rollouts    {runs['num_steps']:,} steps of whole runs{pace}, {left}")
    for label, values in (("best", summary["best"]), ("at the end", summary["final"])):
        if values is not None:
            lines.append(f"  {label:<11} step {values['step']:,}: {described(values)}")
    judge = "benchmark" if is_corrector(summary["checkpoint"]) else "evaluate"
    lines.append(f"  to judge it {command(judge)} {override('ckpt', shown_path(summary['checkpoint']))}")
    return lines


def described(values: Mapping[str, float | None]) -> str:
    """Return validation errors in words, leaving out what is not known.

    Args:
        values: errors by their names in `metrics.summary.ERRORS` and `SUMMARY`, without a prefix.
    """
    known = {name: value for name, value in values.items() if value is not None and math.isfinite(value)}
    if not {"position_error", "deposit_error"} & known.keys():
        return "rollouts not finite"
    parts = [f"position error {known['position_error']:.3g} spacings"] if "position_error" in known else []
    for name, word in (("runout_99_error", "runout"), ("mean_height_error", "mean height")):
        if name in known:
            parts.append(f"{word} {100 * known[name]:+.0f} %")
    if "deposit_error" in known:
        roots = [f"{name} {100 * known[f'{name}_rms']:.1f} %" for name in DEPOSIT]
        parts.append(f"deposit off by {100 * known['deposit_error']:.1f} % ({', '.join(roots)})")
    if "column_runout_error" in known:
        parts.append(f"runout of columns off by {100 * known['column_runout_error']:.1f} %")
    if "speed_mean" in known:
        parts.append(f"{known['speed_mean']:.2g} m/s at the end")
    return ", ".join(parts)
