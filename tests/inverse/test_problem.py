"""Gradients through the rollout against differences of it, and what was hidden found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.inverse import Bounds, ByDifferences, ByGradient, Problem, lbfgs
from gns_pl.rollout import rollout
from gns_pl.scene import Scene, Wall, column_collapse
from gns_pl.scene.definition import FACES
from gns_pl.trajectory import Trajectory
from tests.conftest import SAND, make_simulator, make_start

PLACES = torch.arange(0.02, 1.5, 0.02, dtype=torch.float64)
BOUNDS = Bounds((0.36, -1.0), (1.0, 1.0))


@pytest.fixture(scope="module")
def start() -> Trajectory:
    walls = {face: Wall("friction", 0.385) for face in FACES[2]}
    scene: Scene = column_collapse(
        domain=(1.5, 0.7), length=0.3, height=0.3, gravity=9.81, duration=0.5, material=SAND, walls=walls
    )
    return make_start(scene, 0.06)


def problem_of(start: Trajectory, truth: tuple[float, float], *, double: bool = True, **changes: object) -> Problem:
    """A deposit that the simulator made itself."""
    simulator = make_simulator(dim=2, output="gated", context=True, connectivity_radius=0.13)
    simulator = simulator.double() if double else simulator
    blank = Problem(simulator, start, 6, PLACES, torch.ones_like(PLACES), 0.05)
    with torch.no_grad():
        made = blank.thickness(blank.rollout(torch.tensor([truth], dtype=torch.float64))[-1, 0])
    return replace(blank, observed=made.double(), **changes)


@pytest.mark.parametrize("recompute", [False, True])
def test_the_gradient_is_that_of_differences(start: Trajectory, recompute: bool) -> None:
    problem = problem_of(start, (0.7, 0.6), recompute=recompute)
    at = np.array([0.5, 0.1])
    misfit, gradient = ByGradient(problem)(at)
    again, differences = ByDifferences(problem, (1e-6, 1e-6))(at)
    assert misfit == pytest.approx(again, rel=1e-9) and misfit > 0
    assert (np.abs(gradient) > 1e-9).all()
    np.testing.assert_allclose(gradient, differences, rtol=1e-4, atol=1e-10)


def test_it_rolls_out_as_everybody_does(start: Trajectory) -> None:
    """The unknowns stand in the scene's place, several sets at once."""
    problem = problem_of(start, (0.7, 0.6), double=False)
    with torch.no_grad():
        both = problem.rollout(torch.tensor([[0.4, -0.3], [0.7, 0.6]]))
    velocity, material = start.initial_velocity.copy(), start.material.copy()
    velocity[:, 0], material[:, start.material_features.index("tan_friction_angle")] = 0.6, 0.7
    shown = replace(start, initial_velocity=velocity, material=material)
    np.testing.assert_allclose(both[:, 1].numpy(), rollout(problem.simulator, shown, 6).position, atol=2e-6)
    assert float((both[-1, 0] - both[-1, 1]).abs().max()) > 5e-3


def test_it_goes_down_to_what_was_hidden(start: Trajectory) -> None:
    """A network that has learned nothing holds no velocity, so that the misfit says more than the unknowns do."""
    way = ByGradient(problem_of(start, (0.7, 0.6)))
    fit = lbfgs(way, (0.68, -0.5), BOUNDS, tolerance=1e-12, most=60)
    assert fit.misfit < 0.02 * fit.path[0, -1] and fit.evaluations == way.num_rollouts == len(fit.path)
    assert fit.unknowns[1] == pytest.approx(0.6, abs=0.15)


def test_a_simulator_that_knows_no_friction_is_refused(start: Trajectory) -> None:
    with pytest.raises(InputError, match="tan_friction_angle"):
        Problem(make_simulator(dim=2, material_features=()), start, 2, PLACES, torch.ones_like(PLACES), 0.05)
    with pytest.raises(InputError, match="two dimensions"):
        Problem(make_simulator(), start, 2, PLACES, torch.ones_like(PLACES), 0.05)
