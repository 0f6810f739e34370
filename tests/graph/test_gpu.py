"""On a GPU the same graph and the same step as on the CPU."""

from __future__ import annotations

import pytest
import torch

from gns_pl.graph import radius_graph
from tests.conftest import make_simulator, make_static

pytestmark = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")]


def test_the_cell_list_on_the_gpu_finds_the_oracles_edges() -> None:
    position = torch.rand(3000, 3, generator=torch.Generator().manual_seed(0))
    expected = radius_graph(position, 0.1, backend="brute_force")
    assert torch.equal(radius_graph(position.cuda(), 0.1).cpu(), expected)


@pytest.mark.parametrize("context", [False, True])
def test_a_step_agrees_with_the_cpu(context: bool) -> None:
    simulator, static = make_simulator(context=context), make_static(300, graphs=2)
    history = 0.002 * torch.rand(600, 4, 3) + torch.rand(600, 1, 3)
    expected = simulator(history, static)
    got = simulator.cuda()(history.cuda(), static.to("cuda"))
    torch.testing.assert_close(got.cpu(), expected, atol=1e-5, rtol=0)
