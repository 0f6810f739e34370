"""The errors of validation rollouts, made on several processes, as if one had made them all.

Their names are read before anything runs (`training.summary`), so nothing heavy is imported here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gns_pl.metrics.summary import ERRORS, SUMMARY

if TYPE_CHECKING:
    from lightning.pytorch import Trainer

STEP_SECONDS = "rollout_step_seconds"
"""Wall time of one step of a validation rollout [s]."""

DEPOSIT = ("front", "map", "height")
"""Errors of the final deposit against all points of the fine run: `training.deposits`. Rows hold their squares."""

DEPOSIT_ERROR = "deposit_error"
"""The larger of the root mean squares of front and map: that by which a chart calls a solver as accurate."""

NAMES = (*(quantity.name for quantity in (*ERRORS, *SUMMARY)), STEP_SECONDS, *(f"{name}_square" for name in DEPOSIT))

MONITORED = "position_error"
"""The error that the progress bar shows and the best checkpoint is chosen by. A rollout that fails makes it NaN; the
others are averaged over the trajectories that they are defined for."""


class ValidationTable:
    """One row of errors per validation trajectory, filled in by the process that rolled it out.

    Rank r of R rolls out the trajectories r, r + R, r + 2R, …; where there is none left, its slot stays empty, so that
    every process takes part in everything that is done together.
    """

    def __init__(self) -> None:
        self._rows: list[Mapping[str, float] | None] = []

    def add(self, errors: Mapping[str, float] | None) -> None:
        """Append the errors (`rollout_errors`) of this process's next trajectory; None for an empty slot."""
        self._rows.append(errors)

    def means(self, trainer: Trainer) -> dict[str, float]:
        """Return the mean of every error that is defined for a trajectory at least, the same on every process.

        Relative errors of the runout are weighted by the runout they are relative to: that of a drop is a spacing or
        two, and its error would outweigh those of all columns.

        Errors of the deposit become root mean squares over scenes and placements; the worse is `DEPOSIT_ERROR`.

        Rows are put together before they are summed, so the means do not depend on the number of processes.

        Args:
            trainer: it knows the processes.
        """
        import torch

        rank, ranks, strategy = trainer.global_rank, trainer.world_size, trainer.strategy
        precision = torch.float32 if strategy.root_device.type == "mps" else torch.float64
        table = torch.zeros((len(self._rows) * ranks, 2, len(NAMES)), dtype=precision)
        for slot, errors in enumerate(self._rows):
            if errors is None:
                continue
            for column, name in enumerate(NAMES):
                value = errors.get(name, math.nan)
                if name == MONITORED or not math.isnan(value):
                    weight = _weight(name, errors)
                    table[slot * ranks + rank, :, column] = torch.tensor([weight * value, weight], dtype=precision)
        joined = strategy.reduce(table.to(strategy.root_device), reduce_op="sum").cpu()
        total, count = joined.sum(dim=0).tolist()
        means = {name: total[i] / count[i] for i, name in enumerate(NAMES) if count[i]}
        roots = {f"{name}_rms": math.sqrt(means.pop(f"{name}_square")) for name in DEPOSIT if f"{name}_square" in means}
        worse = {DEPOSIT_ERROR: max(roots["front_rms"], roots["map_rms"])} if roots else {}
        return means | roots | worse


def _weight(name: str, errors: Mapping[str, float]) -> float:
    if name != "runout_99_error":
        return 1.0
    return abs(errors["runout_99"] - errors["runout_99_difference"])
