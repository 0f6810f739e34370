"""What a trained solver cost before it ran its first scene: the data it learned from, and the training.

New checkpoints carry it in their provenance; earlier ones of the trainer know their own wall time; what comes with the
package stands in `pretrained/costs.csv`, made before checkpoints knew. What nobody knows can be told (`costs=`).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.plan import Cost
from gns_pl.models.shipped import FOLDER
from gns_pl.solvers.hybrid import HybridSolver
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.solver import Solver
from gns_pl.solvers.trained import TrainedSolver

KEYS = ("data_seconds", "train_seconds")


def shipped_seconds(what: str, name: str) -> float | None:
    """Return a time of the package's own table [s]; None if it is not there.

    Args:
        what: "data" or "training".
        name: of the data set, or of the model.
    """
    with (FOLDER / "costs.csv").open(newline="", encoding="utf-8") as file:
        found = [float(row["seconds"]) for row in csv.DictReader(file) if (row["what"], row["name"]) == (what, name)]
    return found[0] if found else None


def cost_of_entry(entry: Solver, told: Mapping[str, Any]) -> Cost:
    """Return what a trained solver cost.

    Args:
        entry: of a trained group.
        told: name of an entry → {data_seconds, train_seconds}, either or both; what is told counts.

    Raises:
        InputError: other keys, or times that are no numbers.
    """
    given = told.get(entry.name) or {}
    if set(given) - set(KEYS) or not all(isinstance(each, int | float) and each >= 0 for each in given.values()):
        raise InputError(f"costs.{entry.name}: takes {' and '.join(KEYS)}, numbers of seconds, not {given}.")
    path = entry.file()
    trained = entry.learned if isinstance(entry, HybridSolver) else entry
    if path is None or not isinstance(trained, TrainedSolver):
        return Cost(math.nan, math.nan, "nothing was trained")
    known: dict[str, Any] = dict(trained.provenance.get("cost") or {})
    shipped = path.parent == FOLDER
    found = {
        "data_seconds": (
            ("told", given.get("data_seconds")),
            ("provenance", known.get("data_seconds")),
            ("costs.csv", shipped_seconds("data", str(trained.data.get("name")))),
        ),
        "train_seconds": (
            ("told", given.get("train_seconds")),
            ("provenance", known.get("train_seconds")),
            ("the trainer's clock", _clock_seconds(trained)),
            ("costs.csv", shipped_seconds("training", path.stem) if shipped else None),
        ),
    }
    values, sources = [], []
    for key, places in found.items():
        source, value = next(((s, v) for s, v in places if v is not None), ("unknown", math.nan))
        values.append(float(value))
        sources.append(f"{key.removesuffix('_seconds').replace('train', 'training')}: {source}")
    return Cost(values[0], values[1], "; ".join(sources))


def _clock_seconds(solver: TrainedSolver) -> float | None:
    """Return the wall time that the trainer's own checkpoints hold [s]."""
    if not isinstance(solver, LearnedSolver) or solver.path is None:
        return None
    from gns_pl.models.checkpoint import read_content

    clock = (read_content(solver.path).get("callbacks") or {}).get("Clock") or {}
    return float(clock["seconds"]) if "seconds" in clock else None
