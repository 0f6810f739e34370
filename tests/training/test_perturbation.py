from __future__ import annotations

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.training.perturbation import Perturbation
from tests.conftest import make_random, make_simulator, make_static


def make(**changes: float) -> Perturbation:
    values = {"noise_std": 1e-3, "noise_free": 0.0, "strain_std": 0.0, "strain_length": 0.1, "restore": 0.0}
    return Perturbation(**(values | changes))


def history_and_next() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    whole = 0.2 + 0.6 * torch.rand(40, 1, 3, generator=generator) + torch.rand(40, 5, 3, generator=generator) * 0.01
    return whole[:, :-1], whole[:, -1]


def test_after_the_standard_correction_the_velocity_is_right() -> None:
    """Sanchez-Gonzalez et al. 2020: the target's velocity is the true one, the position error stays."""
    history, following = history_and_next()
    static, simulator = make_static(40), make_simulator()
    noisy, goal = make()(history, following, static, make_random(static))
    assert not torch.equal(noisy, history)
    reached = simulator.integrate(noisy, simulator.target(noisy, goal, static), static)
    torch.testing.assert_close(reached - noisy[:, -1], following - history[:, -1], atol=1e-6, rtol=0)


def test_full_restoring_leads_back_to_the_truth() -> None:
    history, following = history_and_next()
    static = make_static(40)
    _, goal = make(restore=1.0, strain_std=0.05)(history, following, static, make_random(static))
    assert torch.equal(goal, following)


def test_coherent_noise_moves_the_whole_history_alike() -> None:
    history, following = history_and_next()
    static = make_static(40)
    noisy, _ = make(noise_std=0.0, strain_std=0.05)(history, following, static, make_random(static))
    torch.testing.assert_close(noisy.diff(dim=1), history.diff(dim=1), atol=1e-6, rtol=0)
    assert (noisy - history).abs().max() > 1e-4


def test_noise_free_share_and_kinematic_particles() -> None:
    history, following = history_and_next()
    static = make_static(4, graphs=10)
    static.particle_type[::4] = 3
    noisy, _ = make(noise_free=0.5)(history, following, static, make_random(static))
    touched = (noisy != history).flatten(1).any(dim=1)
    assert not touched[::4].any()
    per_graph = touched.view(10, 4)[:, 1:]
    assert (per_graph.all(dim=1) | ~per_graph.any(dim=1)).all()
    assert 0 < int(per_graph.any(dim=1).sum()) < 10


@pytest.mark.parametrize(
    "change", [{"noise_std": -1.0}, {"noise_free": 1.5}, {"restore": -0.1}, {"strain_length": 0.0}]
)
def test_refusals(change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        make(**change)
