from __future__ import annotations

import math

import pytest
import torch

import gns_pl.graph.context
from gns_pl.errors import InputError
from gns_pl.graph.context import ContextGrid, context_fields


def layer(dim: int, height: float, spacing: float) -> torch.Tensor:
    """A layer of the stated height that fills the unit box's floor, as a lattice."""
    axes = [torch.arange(0.5 * spacing, 1, spacing, dtype=torch.float64)] * (dim - 1)
    return torch.cartesian_prod(*axes, torch.arange(0.5 * spacing, height, spacing, dtype=torch.float64)).view(-1, dim)


def still(position: torch.Tensor) -> torch.Tensor:
    """Velocities of particles at rest."""
    return torch.zeros_like(position)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_layer_has_the_depth_below_its_surface(dim: int) -> None:
    position = layer(dim, 0.6, 0.05)
    corners = torch.zeros(1, dim).double(), torch.ones(1, dim).double()
    batch = torch.zeros(len(position), dtype=torch.int64)
    thickness, _, empty, _ = context_fields(
        position,
        still(position),
        ContextGrid.of(*corners, 0.1),
        batch,
        volume=torch.full((len(position),), 0.05**dim).double(),
    )
    inside = ((position[:, :-1] > 0.15) & (position[:, :-1] < 0.85)).all(dim=1) & (position[:, -1] < 0.45)
    depth = 0.6 - position[:, -1]
    assert (thickness - depth)[inside].abs().max() < 0.03
    assert thickness.min() >= 0 and thickness.max() < 0.62
    assert empty[inside].abs().max() < 0.01


def test_total_is_conserved_and_boxes_are_apart() -> None:
    """Two boxes: what lies in one is not felt in the other; a lone particle feels half of itself at most."""
    position = torch.tensor([[0.5, 0.5, 0.1], [0.5, 0.5, 0.9], [0.5, 0.2, 0.1]])
    corners = torch.zeros(2, 3), torch.tensor([[1.0, 1.0, 1.0], [1.5, 0.5, 0.7]])
    thickness, *_ = context_fields(
        position,
        still(position),
        ContextGrid.of(*corners, 0.1),
        torch.tensor([0, 0, 1]),
        volume=torch.full((len(position),), 1e-3),
    )
    assert thickness[0] > thickness[2] > 0
    assert thickness[0] == pytest.approx(float(thickness[2]) + 0.1, abs=0.02)


def test_it_is_continuous_where_particles_cross_cells() -> None:
    base = layer(3, 0.3, 0.1).float()
    corners = torch.zeros(1, 3), torch.ones(1, 3)
    batch = torch.zeros(len(base), dtype=torch.int64)
    values = []
    for shift in (-1e-5, 1e-5):
        moved = base.clone()
        moved[:, 0] += 0.05 + shift  # lattice points at multiples of the cell
        values += context_fields(
            moved, moved.flip(0), ContextGrid.of(*corners, 0.1), batch, volume=torch.full((len(base),), 1e-3)
        )
    for before, after, tolerance in zip(values[:4], values[4:], (1e-4, 1e-4, 1e-4, 1e-3), strict=True):
        torch.testing.assert_close(before, after, atol=tolerance, rtol=0)


def test_particles_outside_the_box_are_taken_to_its_edge() -> None:
    position = torch.tensor([[-0.2, 0.5, 0.5], [1.3, 0.5, 1.7]])
    corners = torch.zeros(1, 3), torch.ones(1, 3)
    thickness, *_ = context_fields(
        position,
        still(position),
        ContextGrid.of(*corners, 0.1),
        torch.zeros(2, dtype=torch.int64),
        volume=torch.full((len(position),), 1e-3),
    )
    assert torch.isfinite(thickness).all()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("cell", [0.1, 0.07])
def test_a_sound_layer_has_solid_fraction_one_up_to_the_walls(dim: int, cell: float) -> None:
    """Also beside walls, and where the box is no multiple of the cell; squeezed by a tenth, it has a tenth more."""
    position = layer(dim, 0.6, 0.02 if dim == 2 else 0.04)
    corners = torch.zeros(1, dim).double(), torch.ones(1, dim).double()
    batch = torch.zeros(len(position), dtype=torch.int64)
    volume = torch.full((len(position),), (0.02 if dim == 2 else 0.04) ** dim).double()
    *_, fraction = context_fields(position, still(position), ContextGrid.of(*corners, cell), batch, volume=volume)
    below = position[:, -1] < 0.45
    assert (fraction[below] - 1).abs().max() < 0.2 and fraction[below].mean() == pytest.approx(1, abs=0.03)
    squeezed = position * torch.tensor([*[1.0] * (dim - 1), 0.9])
    *_, denser = context_fields(squeezed, still(squeezed), ContextGrid.of(*corners, cell), batch, volume=volume)
    assert float(denser[below].mean() / fraction[below].mean()) == pytest.approx(1 / 0.9, rel=0.03)


@pytest.mark.parametrize("gap", [0.05, 0.13, 0.3])
def test_a_lifted_body_has_the_gap_below_it(gap: float) -> None:
    position = layer(3, 0.4, 0.05)
    position[:, -1] += gap
    corners = torch.zeros(1, 3).double(), torch.ones(1, 3).double()
    batch = torch.zeros(len(position), dtype=torch.int64)
    volume = torch.full((len(position),), 0.05**3).double()
    thickness, _, empty, _ = context_fields(
        position, still(position), ContextGrid.of(*corners, 0.1), batch, volume=volume
    )
    inside = (position[:, -1] > gap + 0.1) & (position[:, -1] < gap + 0.3)
    assert (empty[inside] - gap).abs().max() < 0.02
    assert (thickness[inside] - (0.4 + gap - position[inside, -1])).abs().max() < 0.02


@pytest.mark.parametrize("dim", [2, 3])
def test_momentum_above_is_that_of_what_lies_above(dim: int) -> None:
    """Moved as one it is the thickness times the velocity; below a layer that moves it is that layer's."""
    position = layer(dim, 0.6, 0.05)
    corners = torch.zeros(1, dim).double(), torch.ones(1, dim).double()
    batch, volume = torch.zeros(len(position), dtype=torch.int64), torch.full((len(position),), 0.05**dim).double()
    wind = torch.arange(1.0, dim + 1).double()
    thickness, momentum, *_ = context_fields(
        position, wind.expand_as(position), ContextGrid.of(*corners, 0.1), batch, volume=volume
    )
    torch.testing.assert_close(momentum, thickness[:, None] * wind)
    fast = wind * (position[:, -1:] > 0.4)
    _, momentum, *_ = context_fields(position, fast, ContextGrid.of(*corners, 0.1), batch, volume=volume)
    inside = ((position[:, :-1] > 0.15) & (position[:, :-1] < 0.85)).all(dim=1) & (position[:, -1] < 0.25)
    torch.testing.assert_close(momentum[inside], (0.2 * wind).expand_as(momentum[inside]), atol=0.01 * dim, rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("boxes", [1, 3])
def test_nodes_at_particles_alone_give_what_all_nodes_give(
    dim: int, boxes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values and gradients, with particles on the floor, on the far faces and outside; boxes of different sizes."""
    generator = torch.Generator().manual_seed(dim + boxes)

    def draw(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=generator)

    lower = draw(boxes, dim)
    upper = lower + 1 + 3 * draw(boxes, dim)
    batch = torch.randint(boxes, (500,), generator=generator).sort().values
    base = lower[batch] + (upper - lower)[batch] * (1.1 * draw(500, dim) ** 2 - 0.05)
    base[::7, -1], base[::11, 0] = lower[batch[::7], -1], upper[batch[::11], 0]
    velocity, volume = draw(500, dim) - 0.5, 1e-3 * draw(500)
    results = []
    for most in (10**9, 0):
        monkeypatch.setattr(gns_pl.graph.context, "DENSE_NODES", most)
        grid, position = ContextGrid.of(lower, upper, 0.11), base.clone().requires_grad_()
        assert (grid.room is None) == (most == 0)
        fields = context_fields(position, velocity, grid, batch, volume=volume)
        (gradient,) = torch.autograd.grad(sum(each.sin().sum() for each in fields), position)
        results.append((*fields, gradient))
    for whole, sparse in zip(*results, strict=True):
        torch.testing.assert_close(sparse, whole, rtol=1e-10, atol=1e-10)


def test_a_box_of_a_hundred_metres_is_felt_as_a_small_one() -> None:
    """The depth below a surface does not depend on how far the walls are, and neither does the memory."""
    position = layer(3, 0.6, 0.05).float()
    volume, batch = torch.full((len(position),), 0.05**3), torch.zeros(len(position), dtype=torch.int64)
    results = []
    for edge in (2.0, 100.0):
        grid = ContextGrid.of(torch.zeros(1, 3), torch.full((1, 3), edge), 0.1)
        results.append(context_fields(position, still(position), grid, batch, volume=volume))
    assert math.prod(grid.shape) > 10**9 and grid.room is None
    for near, far in zip(*results, strict=True):
        torch.testing.assert_close(far, near, rtol=1e-4, atol=1e-4)


def test_a_box_whose_cells_cannot_be_numbered_is_refused() -> None:
    with pytest.raises(InputError, match=r"box of 1e\+08 m has too many cells of the radius, 0.01 m"):
        ContextGrid.of(torch.zeros(1, 3), torch.full((1, 3), 1e8), 0.01)
