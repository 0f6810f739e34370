"""A last layer fitted by differences of whole runs: exact where the answer is linear, and better on the runs it saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gns_pl.metrics.observables import compute_observables
from gns_pl.models.corrector import Corrector
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.solvers.correction import CoarseStart, corrected_run
from gns_pl.training.last_layer import NOISE, OUTPUT, fit_last_layer, principal_directions, residual, ridge_step
from gns_pl.training.whole_runs import FineRun
from tests.conftest import SAND
from tests.training.test_straight import CONFIG


def test_the_step_is_that_of_the_ridge() -> None:
    """Where residuals are many and linear the numbers come out; one that changes nothing stays 0."""
    draw = np.random.default_rng(0)
    jacobian, numbers = draw.normal(size=(400, 3)), np.array([0.5, -1.0, 0.2])
    found = ridge_step(np.concatenate([jacobian, np.zeros((400, 1))], axis=1), -jacobian @ numbers)
    np.testing.assert_allclose(found, [*numbers, 0.0], atol=1e-3)
    alone = ridge_step(np.array([[1.0]]), np.array([-NOISE]))
    assert alone[0] == pytest.approx(NOISE / (1 + NOISE**2))


def test_directions_are_of_one_size_and_independent() -> None:
    seen = np.concatenate([np.random.default_rng(1).normal(size=(200, 5)) * [3, 1, 1, 1, 0.1], np.ones((200, 1))], 1)
    outputs = seen @ principal_directions(seen, 4).T
    np.testing.assert_allclose(outputs.T @ outputs / 200, OUTPUT**2 * np.eye(4), atol=1e-12)


def test_a_run_that_was_corrected_is_found_again() -> None:
    """Fine runs are corrected ones here, so the fit has to lead an untrained last layer towards theirs."""
    walls = dict.fromkeys(FACES[3], Wall("friction", 0.385))

    def column(height: float) -> Scene:
        return column_collapse(
            domain=(0.9, 0.4, 0.6), length=0.28, height=height, gravity=9.81, duration=0.5, material=SAND, walls=walls
        )

    torch.manual_seed(0)
    corrector = Corrector(replace(CONFIG, interval=0.05)).eval()
    last = corrector.network.decoder[-1]
    with torch.no_grad():
        last.bias.fill_(0.5)  # every point is given half of what may be given
    runs = []
    for seed, height in enumerate((0.25, 0.4)):
        start = CoarseStart.retuned(corrector.config, column(height), seed, {})
        run = start.reduction.lift(corrected_run(corrector, start, 10))
        runs.append(FineRun(run, compute_observables(run, 1 / 12)))
    with torch.no_grad():
        last.bias.zero_()

    def error() -> float:
        starts = [CoarseStart.retuned(corrector.config, run.start.scene, seed, {}) for seed, run in enumerate(runs)]
        return float(
            np.square([residual(corrector, run, start)[0] for run, start in zip(runs, starts, strict=True)]).sum()
        )

    before = error()
    fit_last_layer(corrector, runs, num_directions=2, seed=0)
    assert error() < 0.1 * before
