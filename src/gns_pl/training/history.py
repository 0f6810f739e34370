"""What a run logged, read back from its CSV files: one per start, put together as one training."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TRAINING = ("loss", "hours", "step_seconds", "windows_per_s")
"""Columns of the training's rows, besides "step"."""

PREFIX = "valid/"
"""Columns of validations begin with it."""


@dataclass(frozen=True)
class History:
    """The numbers of a run over its steps, NaN where one was not logged.

    Attributes:
        training: "step" (steps made) and the names in `TRAINING` → [rows].
        validation: "step", "hours" and the names of the errors without their prefix → [validations].
        num_starts: how often the run was started.
    """

    training: dict[str, Floats]
    validation: dict[str, Floats]
    num_starts: int


def read_history(run: Path) -> History:
    """Read `csv/*/metrics.csv` of a run's folder, the starts in the order of their names.

    A start that goes on from a checkpoint repeats the steps that the one before made after it; the repetition counts,
    so that every step is there once. Files of other shape or without a row add nothing.

    Args:
        run: folder of the run.
    """
    starts = [rows for rows in (_read_rows(path) for path in sorted(run.glob("csv/*/metrics.csv"))) if rows]
    merged: list[dict[str, float]] = []
    for rows in starts:
        first = min(row["step"] for row in rows)
        merged = [row for row in merged if row["step"] < first] + rows
    validations = [row for row in merged if any(name.startswith(PREFIX) for name in row)]
    errors = list(dict.fromkeys(name for row in validations for name in row if name.startswith(PREFIX)))
    validation = {name.removeprefix(PREFIX): _column(validations, name) for name in ("step", "hours", *errors)}
    training = {name: _column([row for row in merged if "loss" in row], name) for name in ("step", *TRAINING)}
    return History(training, validation, len(starts))


def _read_rows(path: Path) -> list[dict[str, float]]:
    """Return the rows as name → number without their empty cells; "step" counts the steps made."""
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            row = {name: value for name, cell in line.items() if cell and (value := _number(cell)) is not None}
            if "step" in row:  # a line that a kill cut short may have none
                rows.append(row | {"step": row["step"] + 1})
    return rows


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except (TypeError, ValueError):
        return None


def _column(rows: list[dict[str, float]], name: str) -> Floats:
    return np.array([row.get(name, math.nan) for row in rows], dtype=np.float64)
