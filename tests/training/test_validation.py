"""Validation errors gathered from several processes are those that one process would have found, to the last bit."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gns_pl.training.validation import DEPOSIT_ERROR, MONITORED, NAMES, ValidationTable


def make_errors(number: int) -> list[dict[str, float]]:
    generator = np.random.default_rng(number)
    errors = [dict(zip(NAMES, generator.normal(size=len(NAMES)), strict=True)) for _ in range(number)]
    errors[1]["runout_99_error"] = math.nan  # not defined for this scene
    for each in errors:
        each["profile_l1"] = math.nan  # for none
        each.update({name: value**2 for name, value in each.items() if name.endswith("_square")})
    return errors


def gathered(errors: list[dict[str, float]], ranks: int) -> list[dict[str, float]]:
    """Means on every rank of so many, whose sums are made here."""
    slots = math.ceil(len(errors) / ranks)
    tables = []
    for rank in range(ranks):
        table = ValidationTable()
        for slot in range(slots):
            number = slot * ranks + rank
            table.add(errors[number] if number < len(errors) else None)
        tables.append(table)
    parts: list[torch.Tensor] = []

    def trainer(rank: int, total: torch.Tensor | None) -> SimpleNamespace:
        def reduce(part: torch.Tensor, reduce_op: str) -> torch.Tensor:
            assert reduce_op == "sum"
            parts.append(part)
            return part if total is None else total

        own = SimpleNamespace(root_device=torch.device("cpu"), reduce=reduce)
        return SimpleNamespace(global_rank=rank, world_size=ranks, strategy=own)

    for rank, table in enumerate(tables):
        table.means(trainer(rank, None))  # type: ignore[arg-type]
    total = torch.stack(parts).sum(dim=0)
    return [table.means(trainer(rank, total)) for rank, table in enumerate(tables)]  # type: ignore[arg-type]


@pytest.mark.parametrize("ranks", [1, 2, 3, 4, 7])
def test_means_do_not_depend_on_the_number_of_processes(ranks: int) -> None:
    errors = make_errors(5)
    (alone,) = gathered(errors, 1)
    assert gathered(errors, ranks) == [alone] * ranks
    assert "profile_l1" not in alone
    assert alone["mse_1"] == pytest.approx(np.mean([each["mse_1"] for each in errors]))
    assert alone["front_rms"] == pytest.approx(np.sqrt(np.mean([each["front_square"] for each in errors])))
    assert alone[DEPOSIT_ERROR] == max(alone["front_rms"], alone["map_rms"])


def test_relative_runouts_are_those_of_all_runouts_together() -> None:
    errors = make_errors(4)
    for each, truth, error in zip(errors, (2.0, 0.5, 0.02, 1.0), (0.1, math.nan, 3.0, -0.2), strict=True):
        each["runout_99_error"], each["runout_99_difference"] = error, error * truth
        each["runout_99"] = truth * (1 + error)
    (alone,) = gathered(errors, 1)
    assert alone["runout_99_error"] == pytest.approx((0.2 + 0.06 - 0.2) / (2.0 + 0.02 + 1.0))


def test_a_failed_rollout_shows_in_the_monitored_error_alone() -> None:
    errors = make_errors(3)
    errors[2][MONITORED] = math.nan
    (alone,) = gathered(errors, 1)
    assert math.isnan(alone[MONITORED]) and not math.isnan(alone["mse_1"])
