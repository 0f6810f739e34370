"""Muon against PyTorch's own, and both optimisers as one: learning rate, state, resuming."""

from __future__ import annotations

import copy

import torch
from torch import nn

from gns_pl.training.optimiser import Muon, MuonAndAdamW, orthogonalised


def network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(7, 16), nn.Linear(16, 16), nn.Linear(16, 16), nn.LayerNorm(16), nn.Linear(16, 3))


def train(net: nn.Module, optimisers: list[torch.optim.Optimizer], steps: int, seed: int = 1) -> None:
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        inputs = torch.randn(32, 7, generator=generator)
        loss = (net(inputs) - inputs[:, :3].sin()).square().mean()
        loss.backward()
        for optimiser in optimisers:
            optimiser.step()
        net.zero_grad()


def test_singular_values_become_about_one() -> None:
    torch.manual_seed(1)
    for shape in ((4, 16, 16), (3, 6, 32), (2, 32, 6)):
        matrices = torch.randn(shape) * torch.tensor([10.0**k for k in range(shape[0])])[:, None, None]
        u, _, v = torch.linalg.svd(matrices, full_matrices=False)
        found = orthogonalised(matrices)
        inner = u.mT @ found @ v.mT
        assert (inner - torch.diag_embed(inner.diagonal(dim1=1, dim2=2))).abs().max() < 1e-3  # the same vectors
        values = inner.diagonal(dim1=1, dim2=2)
        assert values.min() > 0 and values.max() < 1.3 and values.median() > 0.6


def test_it_is_pytorchs_muon_in_float32() -> None:
    """Three steps along gradients of all directions end at the same place, up to bfloat16."""
    one, two = network(), network()
    matrices = [[p for p in net.parameters() if p.ndim == 2] for net in (one, two)]
    before = [p.detach().clone() for p in matrices[0]]
    mine = Muon(matrices[0], lr=0.01, weight_decay=0.1)
    theirs = torch.optim.Muon(matrices[1], lr=0.01, weight_decay=0.1, adjust_lr_fn="match_rms_adamw")
    for _ in range(3):
        for here, there in zip(*matrices, strict=True):
            here.grad = torch.randn_like(here)
            there.grad = here.grad.clone()
        mine.step()
        theirs.step()
    for start, here, there in zip(before, *matrices, strict=True):
        assert (here - there).norm() < 0.05 * (there - start).norm()


def test_vectors_are_adamws_and_one_learning_rate_serves_both() -> None:
    net = network()
    optimiser = MuonAndAdamW(net, lr=0.5, weight_decay=0.0)
    assert [len(group["params"]) for group in optimiser.param_groups] == [4, 6]
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: 0.0 if step else 1.0)
    train(net, [optimiser], 1)
    schedule.step()
    before = copy.deepcopy(net.state_dict())
    train(net, [optimiser], 2)
    assert all(torch.equal(value, before[name]) for name, value in net.state_dict().items())


def test_going_on_is_exact() -> None:
    whole, cut = network(), network()
    train(whole, [MuonAndAdamW(whole, lr=0.01, weight_decay=0.01)], 3, seed=1)
    first = MuonAndAdamW(cut, lr=0.01, weight_decay=0.01)
    train(cut, [first], 3, seed=1)
    state = copy.deepcopy(first.state_dict())
    later = MuonAndAdamW(cut, lr=1.0, weight_decay=0.01)  # the rate is in the state
    later.load_state_dict(state)
    assert later.param_groups[0]["lr"] == later.param_groups[1]["lr"] == 0.01
    train(whole, [first_of(whole, state)], 3, seed=2)
    train(cut, [later], 3, seed=2)
    for one, two in zip(whole.parameters(), cut.parameters(), strict=True):
        assert torch.equal(one, two)


def first_of(net: nn.Module, state: dict[str, object]) -> MuonAndAdamW:
    """Return an optimiser of another network in the same state."""
    optimiser = MuonAndAdamW(net, lr=0.01, weight_decay=0.01)
    optimiser.load_state_dict(copy.deepcopy(state))
    return optimiser
