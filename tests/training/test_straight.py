"""Derivatives of corrected coarse runs: exact for a solver that does what the derivative assumes; halves are lifted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from gns_pl.graph import WindowRandom
from gns_pl.models.corrector import Corrector, CorrectorConfig
from gns_pl.rollout import static_of
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.solvers.correction import CoarseStart, corrected_run
from gns_pl.solvers.fitted_files import read_fitted
from gns_pl.solvers.reduction import halve_scene
from gns_pl.training.straight import mirrored, straight_run
from gns_pl.training.symmetry import Symmetry
from tests.conftest import MPM, SAND

CONFIG = CorrectorConfig(
    dim=3,
    interval=0.02,
    spacing=1.0,
    mpm={key: value for key, value in MPM.items() if key != "jitter"} | {"jitter": 0.5},
    connectivity_radius=1.6,
    latent_size=8,
    num_mlp_layers=1,
    num_message_passing_steps=1,
    velocity_threshold=0.2,
    coarse={"cells": 3.0, "factors": {"wall_friction": 1.1, "internal_friction": 0.8, "damping_rate": 0.2}},
    largest=0.4,
)


@pytest.fixture
def column3() -> Scene:
    walls = dict.fromkeys(FACES[3], Wall("friction", 0.385))
    return column_collapse(
        domain=(0.9, 0.5, 0.6), length=0.3, height=0.4, gravity=9.81, duration=0.2, material=SAND, walls=walls
    )


def trained(seed: int = 0) -> Corrector:
    """A corrector that corrects at random."""
    torch.manual_seed(seed)
    corrector = Corrector(CONFIG).eval()
    last = corrector.network.decoder[-1]
    torch.nn.init.normal_(last.weight, std=0.3)
    torch.nn.init.normal_(last.bias, std=0.3)
    return corrector


class TwoLines:
    """A run that does what the derivative assumes: velocities carry points on, and a share of them is left."""

    def __init__(self, scene: Scene, mpm: Any, points: Any, interval: float) -> None:
        self.position, self.interval = points.position.copy(), interval
        self.velocity = np.random.default_rng(1).normal(scale=0.3, size=self.position.shape)
        self.given = np.zeros_like(self.position)

    def advance(self) -> None:
        self.position = self.position + self.interval * (self.velocity + self.given)

    def add_velocity(self, velocity: Any) -> None:
        self.given = math.exp(-10.0 * self.interval) * (self.given + velocity)


@pytest.mark.parametrize("turns", [False, True])
def test_the_derivative_is_that_of_the_two_lines(turns: bool, column3: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns_pl.training.straight.stepped_run", TwoLines)
    monkeypatch.setattr(
        "gns_pl.training.straight.DECAY", (10.0, 0.0)
    )  # one rate for all, or it would have a derivative
    corrector, start = trained().double(), CoarseStart.retuned(CONFIG, column3, 0, {})
    static = static_of(start.first).in_precision(torch.float64)
    turn = Symmetry.sample(static, WindowRandom(5, torch.tensor([1]), static.batch), torch.float64) if turns else None
    wanted = torch.from_numpy(np.random.default_rng(2).normal(size=(7, start.first.num_particles, 3)))

    def loss() -> Tensor:
        return (straight_run(corrector, start, 6, turn) * wanted).sum()

    loss().backward()
    for name, weight in corrector.named_parameters():
        assert weight.grad is not None, name
        index = int(weight.grad.abs().argmax())
        flat, size = weight.data.view(-1), 1e-6
        flat[index] += size
        above = float(loss().detach())
        flat[index] -= 2 * size
        below = float(loss().detach())
        flat[index] += size
        derivative = float(weight.grad.view(-1)[index])
        assert derivative == pytest.approx((above - below) / (2 * size), rel=1e-3, abs=1e-5), name


def test_the_values_are_those_of_the_run(column3: Scene) -> None:
    corrector, start = trained(), CoarseStart.retuned(CONFIG, column3, 0, {})
    run = corrected_run(corrector, start, 10)
    frames = straight_run(corrector, start, 10)
    np.testing.assert_allclose(frames.detach().numpy(), run.position, atol=1e-5)
    turned = Symmetry(torch.tensor([[-1.0, 1.0, 1.0]]), torch.tensor([[0.9, 0.0, 0.0]]), torch.tensor([[1, 0, 2]]))
    assert not torch.equal(straight_run(corrector, start, 10, turned), frames)  # the network is not symmetric


def test_half_a_scene_is_mirrored_as_it_is_lifted(column3: Scene) -> None:
    walls = {face: Wall("friction", 0.385) for face in FACES[3]}
    body = replace(column3.bodies[0], position=(0.3, 0.1, 0.0), size=(0.3, 0.3, 0.3))  # in the middle, along x and y
    for scene, number in ((column3, 1), (column3.replace(bodies=(body,), walls=walls), 2)):
        reduction = halve_scene(scene)
        start = CoarseStart.retuned(CONFIG, scene, 0, {})
        assert reduction.mirrors == start.reduction.mirrors and len(reduction.mirrors) == number
        lifted = start.reduction.lift(start.first)
        whole = mirrored(torch.from_numpy(start.first.position), scene, reduction.mirrors)
        np.testing.assert_allclose(whole.numpy(), lifted.position, atol=1e-6)
        assert lifted.scene == scene


def test_an_untrained_corrector_leaves_the_coarse_run_as_it_is(column3: Scene) -> None:
    """To the bit; and the coarse run is that of the solver that is corrected, on a half, but for rounding."""
    torch.manual_seed(0)
    untrained, start = Corrector(CONFIG).eval(), CoarseStart.retuned(CONFIG, column3, 3, {})
    run = corrected_run(untrained, start, 10)

    class Nothing(Corrector):
        def forward(self, before: Tensor, *_: Any) -> Tensor:
            return torch.zeros_like(before)

    assert np.array_equal(run.position, corrected_run(Nothing(CONFIG), start, 10).position)
    fit = read_fitted("mpm-retuned-5")
    config = replace(CONFIG, coarse={"cells": fit.cells, "factors": dict(vars(fit.factors))}, mpm=dict(fit.settings))
    alone = fit.run(column3, interval=0.02, seed=3)
    corrector = Corrector(config).eval()
    start = CoarseStart.retuned(config, column3, 3, {})
    run = start.reduction.lift(corrected_run(corrector, start, 10))
    np.testing.assert_allclose(run.position, alone.position, atol=1e-6)  # that one adds in another order


def test_corrections_are_bounded_and_stop_with_the_flow(column3: Scene) -> None:
    corrector, start = trained(), CoarseStart.retuned(CONFIG, column3, 0, {})
    torch.nn.init.constant_(corrector.network.decoder[-1].bias, 100.0)  # tanh is 1
    static, position = static_of(start.first), torch.from_numpy(start.first.position[0])
    moved = position.clone()
    moved[:5] += torch.tensor([0.03, 0.04, -0.02])
    moved[5:9] -= torch.tensor([0.0, 0.0, 0.02])
    bound = 0.4 * 0.02 * start.first.material[0, 0] * 9.81
    with torch.no_grad():
        given = corrector(position, position, moved, static, start.unit)
        assert torch.equal(given[5:], torch.zeros_like(given[5:]))
        assert given.norm(dim=1).max() <= bound and float(given[:5].norm(dim=1).min()) > 0.85 * bound
        np.testing.assert_allclose(given[:5], given[:5, :1] / 0.6 * torch.tensor([0.6, 0.8, 0.0]), atol=1e-6)
        assert math.isclose(start.first.material[0, 0], 0.8 * SAND.tan_friction_angle, rel_tol=1e-6)
        assert not corrector(position, position, position, static, start.unit).any()
