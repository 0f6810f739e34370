"""Edges in blocks, which is how a network runs without gradients, against the same network with them."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from tests.nn.test_edges import make_graph, make_network


@pytest.mark.parametrize("num_mlp_layers", [1, 2, 3])
@pytest.mark.parametrize("edges", [300, 1, 0])
@pytest.mark.parametrize("kind", [{}, {"static_edges": True}])
@pytest.mark.parametrize("block", [300, 5000, 512 * 1024])
def test_blocks_change_nothing(
    num_mlp_layers: int, edges: int, kind: dict[str, Any], block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the size of a block; one node's edges may be more than that."""
    monkeypatch.setattr("gns_pl.nn.blocks.BLOCK_BYTES", block)
    monkeypatch.setattr("gns_pl.nn.encode_process_decode.can_pack", lambda network: False)
    graph, network = make_graph(edges=edges), make_network(num_mlp_layers, **kind)
    expected = network(*graph)
    for without in (torch.no_grad, torch.inference_mode):
        with without():
            got = network(*graph)
            assert not got.requires_grad and torch.equal(got, network(*graph))
        torch.testing.assert_close(got, expected.detach(), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("packs", [True, False])
def test_what_is_not_finite_stays_so(packs: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not packs:
        monkeypatch.setattr("gns_pl.nn.encode_process_decode.can_pack", lambda network: False)
    node, edge, edge_index = make_graph()
    edge[5] = torch.nan
    with torch.no_grad():
        assert torch.isnan(make_network(1)(node, edge, edge_index)).any()
