"""Training on whole runs as the last steps of a training: resumed to the bit, steps that break left out, begun from."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.metrics.observables import compute_observables
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.training.config import RolloutPhase
from gns_pl.training.deposits import Deposits, deposit_errors
from gns_pl.training.outcomes import ERRORS
from gns_pl.training.resume import find_resume
from gns_pl.training.summary import read_summary, summary_lines
from gns_pl.training.train import train
from gns_pl.training.whole_runs import WholeRuns, read_fine_run
from tests.training.conftest import assert_same, make_config, rows

PHASE = tuple(f"training.rollout.{each}" for each in ("num_steps=3", "scenes=2", "whole_from=0.5", "placements=3"))
WEIGHTS = {**dict.fromkeys(ERRORS, 1.0), "windows": 0.1}


def last(output: Path) -> dict[str, Any]:
    content: dict[str, Any] = torch.load(output / "last.ckpt", weights_only=True)
    return content


@pytest.fixture(scope="module")
def two_phases(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of three usual steps and three of whole runs; nobody writes into it."""
    folder = tmp_path_factory.mktemp("phases")
    train(make_config(data_root, folder, *PHASE), folder, None)
    return folder


@pytest.fixture
def runs(two_phases: Path, data_root: Path) -> WholeRuns:
    """The runs of ten steps of two scenes, of which the first half grow."""
    checkpoint = load_checkpoint(two_phases / "last.ckpt")
    found = [read_fine_run(data_root / name, 1) for name in read_manifest(data_root).splits["train"]]
    phase = RolloutPhase(10, 2, 1e-3, 0.5, 2, WEIGHTS)
    return WholeRuns(found, phase, checkpoint.data, symmetry=True, seed=0)


@pytest.mark.parametrize("cut", [3, 5])  # at the boundary of the phases, and behind it
def test_a_resumed_run_is_the_whole_one(cut: int, two_phases: Path, data_root: Path, tmp_path: Path) -> None:
    train(make_config(data_root, tmp_path, *PHASE, f"trainer.max_steps={cut}"), tmp_path, None)
    assert last(tmp_path)["global_step"] == cut
    train(make_config(data_root, tmp_path, *PHASE), tmp_path, find_resume("auto", tmp_path))
    assert_same(last(tmp_path), last(two_phases))


def test_the_first_steps_are_the_usual_ones(two_phases: Path, whole_run: Path) -> None:
    """Before the first whole run the loss is that of a training without them, but for the pace of the learning rate."""
    both = rows(two_phases), rows(whole_run)
    first, usual = (next(float(row["loss"]) for row in each if row["loss"]) for each in both)
    assert first == usual
    logged = [row for row in both[0] if row["rollout/map"]]
    assert len(logged) == 3 and all(float(row[f"rollout/{name}"]) > 0 for row in logged for name in ERRORS[:-1])
    summary = read_summary(two_phases)
    assert summary is not None and summary["rollouts"]["num_steps"] == 3 and summary["rollouts"]["skipped"] == 0
    assert any("3 steps of whole runs" in line and "none left out" in line for line in summary_lines(summary))


def test_a_step_that_is_not_finite_is_left_out_and_counted(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The step of a broken run changes no weight and not what the optimiser remembers; the others go on."""
    whole, seen = WholeRuns.errors, dict[int, list[torch.Tensor]]()

    def errors(self: WholeRuns, simulator: Any, step: int, *processes: int) -> torch.Tensor:
        seen[step] = [weight.detach().clone() for weight in simulator.parameters()]
        found = whole(self, simulator, step, *processes)
        return found * torch.nan if step == 1 else found

    monkeypatch.setattr(WholeRuns, "errors", errors)
    train(make_config(data_root, tmp_path, *PHASE), tmp_path, None)
    assert all(torch.equal(one, two) for one, two in zip(seen[1], seen[2], strict=True))
    assert not all(torch.equal(one, two) for one, two in zip(seen[0], seen[1], strict=True))
    state = last(tmp_path)
    assert state["global_step"] == 6 and state["callbacks"]["SkipNonFinite"]["skipped"] == 1
    assert {float(values["step"]) for values in state["optimizer_states"][0]["adamw"]["state"].values()} == {2.0}
    summary = read_summary(tmp_path)
    assert summary is not None and summary["rollouts"]["skipped"] == 1
    assert any("1 left out" in line for line in summary_lines(summary))
    assert [row["skipped"] for row in rows(tmp_path) if row["skipped"]] == ["0.0", "1.0", "1.0"]


def test_runs_that_always_break_end_the_training(
    data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gns_pl.training.callbacks.MOST_SKIPPED", 2)
    monkeypatch.setattr("gns_pl.training.outcomes.STILL", float("nan"))
    with pytest.raises(InputError, match="2 whole runs in a row were not finite"):
        train(make_config(data_root, tmp_path, *PHASE), tmp_path, None)


def test_scenes_follow_from_the_step_and_are_started_as_users_do(runs: WholeRuns, two_phases: Path) -> None:
    simulator = load_checkpoint(two_phases / "last.ckpt").simulator
    assert [number for step in range(3) for _, number in runs.drawn(step, 0, 1)] == [0, 1, 2, 3, 4, 5]
    joined = [runs.drawn(4, rank, 2)[0] for rank in range(2)]
    assert [(id(run), number) for run, number in joined] == [(id(run), number) for run, number in runs.drawn(4, 0, 1)]
    run, number = joined[0]
    start, again, other = (runs.start(simulator, run, each) for each in (number, number, number + 1))
    assert (start.position == again.position).all() and (start.position != other.position).any()
    solver = LearnedSolver("learned", two_phases / "last.ckpt")
    assert (solver.start(run.start.scene, number).position == start.position).all()  # the training's seed is 0
    assert [runs.length(run, step) for step in (0, 1, 4, 9)] == [2, 4, 10, 10]


def test_a_broken_run_has_no_errors_and_a_gradient_that_is_none(
    runs: WholeRuns, two_phases: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator = load_checkpoint(two_phases / "last.ckpt").simulator
    with torch.no_grad():
        for parameter in simulator.parameters():
            parameter.fill_(torch.inf)
    runs.loss(runs.errors(simulator, 9)).backward()
    assert all(bool(parameter.grad.isnan().all()) for parameter in simulator.parameters())  # type: ignore[union-attr]


def test_the_errors_fall(runs: WholeRuns, two_phases: Path) -> None:
    """A few steps down the gradient of the same two runs, one of them or both mirrored."""
    simulator = load_checkpoint(two_phases / "last.ckpt").simulator
    optimizer = torch.optim.Adam(simulator.parameters(), lr=3e-3)
    values = []
    for _ in range(8):
        loss = runs.loss(runs.errors(simulator, 9))
        values.append(float(loss.detach()))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(simulator.parameters(), 1.0)
        optimizer.step()
    assert min(values[4:]) < 0.8 * values[0]


def test_a_training_begins_with_the_weights_of_another(two_phases: Path, data_root: Path, tmp_path: Path) -> None:
    begun = load_checkpoint(two_phases / "last.ckpt").simulator.state_dict()
    settings = ("training.optimisation.num_steps=1", "training.optimisation.learning_rate=0", "data.seed=1")
    data = data_root.parent / "other"
    train(make_config(data, tmp_path, *settings, f"ckpt={two_phases}/last.ckpt"), tmp_path, None)
    for name, value in load_checkpoint(tmp_path / "last.ckpt").simulator.state_dict().items():
        assert torch.equal(value, begun[name]), name  # the normalisation too, though the data are others
    with pytest.raises(InputError, match=r"was trained with latent_size=8, and this training has 6"):
        train(
            make_config(data, tmp_path, *settings, "model.latent_size=6", f"ckpt={two_phases}/last.ckpt"),
            tmp_path,
            None,
        )


def test_data_without_observables_are_refused(two_phases: Path, data_root: Path, tmp_path: Path) -> None:
    path = tmp_path / "copy.h5"
    path.write_bytes((data_root / read_manifest(data_root).splits["train"][0]).read_bytes())
    with h5py.File(path, "a") as file:
        del file["observables"]
    with pytest.raises(InputError, match="no observables of the whole run"):
        read_fine_run(path, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_steps": -1}, "num_steps must be a whole number"),
        ({"scenes": 0}, "scenes must be a whole number of at least 1"),
        ({"whole_from": 2.0}, "whole_from is a share"),
        ({"weights": {**WEIGHTS, "maps": 1.0}}, "unknown key maps"),
        ({"weights": {**WEIGHTS, "front": -1.0}}, "weights.front must be a number of at least 0"),
        ({"weights": {**dict.fromkeys(ERRORS, 0.0), "windows": 1.0}}, "must be above 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(RolloutPhase(10, 2, 1e-3, 0.5, 2, WEIGHTS), **changes)


def test_more_steps_of_whole_runs_than_there_are_steps_are_refused(data_root: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="more than all steps of the training"):
        train(make_config(data_root, tmp_path, "training.rollout.num_steps=7"), tmp_path, None)
    assert list(tmp_path.iterdir()) == []


def test_deposits_of_cold_starts_are_validated(two_phases: Path) -> None:
    """Where whole runs are trained on, validations have the errors of a chart, by which weights can be chosen."""
    [row] = [row for row in rows(two_phases) if row["valid/deposit_error"] and row["step"] == "2"]
    front, volumes = (float(row[f"valid/{name}_rms"]) for name in ("front", "map"))
    assert float(row["valid/deposit_error"]) == max(front, volumes) > 0 and float(row["valid/height_rms"]) > 0
    summary = read_summary(two_phases)
    assert summary is not None and "deposit off by" in "".join(summary_lines(summary))


def test_deposits_choose_the_weights_of_single_steps_too(data_root: Path, tmp_path: Path) -> None:
    """As in sweeps of single steps alone; without them a monitor of deposits would keep the first weights."""
    chosen = ("callbacks.best.monitor=valid/deposit_error", "training.rollout.placements=1")
    train(make_config(data_root, tmp_path, *chosen), tmp_path, None)
    errors = [float(row["valid/deposit_error"]) for row in rows(tmp_path) if row.get("valid/deposit_error")]
    summary = read_summary(tmp_path)
    assert len(errors) == 2 and summary is not None and summary["best"]["deposit_error"] == min(errors)


def test_a_fine_run_has_no_error_of_its_own_deposit_and_a_broken_one_any(data_root: Path) -> None:
    path = data_root / read_manifest(data_root).splits["train"][0]
    trajectory = read_trajectory(path)
    fine = compute_observables(trajectory, 0.1)
    assert max(map(abs, deposit_errors(trajectory, fine).values())) < 1e-6
    broken = trajectory.position.copy()
    broken[-1, 0] = math.nan
    assert set(deposit_errors(replace(trajectory, position=broken), fine).values()) == {math.inf}
    higher = replace(fine, mean_height=fine.mean_height / 1.25)
    assert deposit_errors(trajectory, higher)["height"] == pytest.approx(0.25)


def test_the_averaged_weights_are_validated(two_phases: Path, data_root: Path) -> None:
    """The errors of the last validation are those of the weights in last.ckpt, which are the average."""
    solver = LearnedSolver.of(load_checkpoint(two_phases / "last.ckpt"))
    held_out = [read_fine_run(data_root / name, 1) for name in read_manifest(data_root).splits["valid"]]
    deposits = Deposits(held_out, placements=3)
    errors = [deposits.squares(solver, number)["map_square"] for number in range(len(held_out))]
    logged = [row for row in rows(two_phases) if row["valid/map_rms"]]
    assert [row["step"] for row in logged] == ["2", "3", "4", "5"]  # every third step, and often where runs are whole
    assert logged[-2]["valid/map_rms"] != logged[-1]["valid/map_rms"]
    assert float(logged[-1]["valid/map_rms"]) == pytest.approx((sum(errors) / len(errors)) ** 0.5, rel=1e-5)
