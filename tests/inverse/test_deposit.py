"""The thickness of a deposit: volume, its derivative, and no particle has a name."""

from __future__ import annotations

import pytest
import torch

from gns_pl.inverse import deposit_misfit, deposit_thickness

WALLS = (0.0, 1.0)
PLACES = torch.arange(0.0025, 1.0, 0.005, dtype=torch.float64)


@pytest.fixture
def heap() -> tuple[torch.Tensor, torch.Tensor]:
    draw = torch.Generator().manual_seed(0)
    position = torch.rand((60, 2), dtype=torch.float64, generator=draw)
    return position, 1e-3 * (1 + torch.rand(60, dtype=torch.float64, generator=draw))


def test_it_holds_all_of_the_volume(heap: tuple[torch.Tensor, torch.Tensor]) -> None:
    """Also of what lies at a wall."""
    thickness = deposit_thickness(*heap, PLACES, 0.05, WALLS)
    assert float(thickness.sum() * 0.005) == pytest.approx(float(heap[1].sum()), rel=1e-4)


def test_an_even_layer_is_as_thick_as_it_is() -> None:
    side = 0.02
    along = torch.arange(side / 2, 1, side, dtype=torch.float64)
    position = torch.cartesian_prod(along, torch.tensor([0.01, 0.03, 0.05], dtype=torch.float64))
    thickness = deposit_thickness(position, torch.full((150,), side**2, dtype=torch.float64), PLACES, 0.05, WALLS)
    torch.testing.assert_close(thickness, torch.full_like(PLACES, 0.06), rtol=1e-6, atol=0.0)


def test_it_does_not_ask_which_particle_lies_where(heap: tuple[torch.Tensor, torch.Tensor]) -> None:
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    shuffled = deposit_thickness(heap[0][order], heap[1][order], PLACES, 0.05, WALLS)
    torch.testing.assert_close(shuffled, deposit_thickness(*heap, PLACES, 0.05, WALLS))


def test_its_derivative_is_that_of_differences(heap: tuple[torch.Tensor, torch.Tensor]) -> None:
    observed = deposit_thickness(0.9 * heap[0], heap[1], PLACES, 0.05, WALLS)

    def misfit(position: torch.Tensor) -> torch.Tensor:
        return deposit_misfit(deposit_thickness(position, heap[1], PLACES, 0.05, WALLS), observed)

    assert torch.autograd.gradcheck(misfit, heap[0].clone().requires_grad_())
    assert float(deposit_misfit(observed, observed)) == 0
