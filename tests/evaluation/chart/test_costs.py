"""What was spent before: told, from the checkpoint, from the trainer's clock, from the package's table."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from gns_pl import load_solver
from gns_pl.errors import InputError
from gns_pl.evaluation.chart.costs import cost_of_entry, shipped_seconds
from gns_pl.models.checkpoint import Checkpoint, read_content, save_checkpoint
from gns_pl.models.shipped import corrector_names, pretrained_names
from gns_pl.solvers.corrected import CorrectedSolver
from gns_pl.solvers.learned import LearnedSolver
from tests.conftest import make_simulator


def entry(path: Path, **provenance: object) -> LearnedSolver:
    save_checkpoint(path, Checkpoint(make_simulator(dim=2), {"name": "collapse_plane"}, dict(provenance)))
    return LearnedSolver("mine", path)


def test_the_checkpoint_knows(tmp_path: Path) -> None:
    cost = cost_of_entry(entry(tmp_path / "a.ckpt", cost={"data_seconds": 5.0, "train_seconds": 7.0}), {})
    assert (cost.data_seconds, cost.train_seconds, cost.seconds) == (5, 7, 12)
    assert cost.source == "data: provenance; training: provenance"


def test_what_is_told_counts(tmp_path: Path) -> None:
    mine = entry(tmp_path / "a.ckpt", cost={"data_seconds": 5.0, "train_seconds": 7.0})
    assert cost_of_entry(mine, {"mine": {"train_seconds": 9}}).seconds == 14
    for wrong in ({"seconds": 1}, {"data_seconds": "long"}, {"data_seconds": -1}):
        with pytest.raises(InputError, match=r"costs\.mine: takes data_seconds and train_seconds"):
            cost_of_entry(mine, {"mine": wrong})


def test_earlier_checkpoints_of_the_trainer_have_its_clock(tmp_path: Path) -> None:
    mine = entry(tmp_path / "a.ckpt")
    assert math.isnan(cost_of_entry(mine, {}).train_seconds)
    content = read_content(tmp_path / "a.ckpt")
    torch.save({**content, "callbacks": {"Clock": {"seconds": 11.0}}}, tmp_path / "a.ckpt")
    cost = cost_of_entry(mine, {})
    assert cost.train_seconds == 11 and "the trainer's clock" in cost.source
    assert cost.data_seconds == shipped_seconds("data", "collapse_plane")


def test_of_all_that_comes_with_the_package_it_is_known() -> None:
    for name in (*pretrained_names(), *corrector_names()):
        cost = cost_of_entry(load_solver(name, device="cpu"), {})
        assert cost.seconds > 0 and cost.train_seconds > 0, name
    cost = cost_of_entry(CorrectedSolver("corrected_plane", "corrected_plane"), {})
    assert cost.seconds > 0 and cost.source == "data: costs.csv; training: costs.csv"
