from __future__ import annotations

import torch

from gns_pl.training.symmetry import Symmetry, sample_symmetry
from tests.conftest import make_random, make_static


def test_boxes_distances_and_gravity_go_along() -> None:
    """Whatever is drawn, pair distances stay, and the distances to the walls are the old ones in another order."""
    generator = torch.Generator().manual_seed(0)
    static = make_static(30, graphs=16, gravity=(1.0, -2.0, -9.0))
    static.upper[:] = torch.tensor([1.5, 0.5, 0.7])
    history = torch.rand(480, 4, 3, generator=generator) * static.upper[static.batch][:, None]
    following = torch.rand(480, 3, generator=generator) * static.upper[static.batch]
    turned, scenes = sample_symmetry(torch.cat([history, following[:, None]], dim=1), static, make_random(static))
    new, new_following = turned[:, :-1], turned[:, -1]
    variants = set()
    for graph in range(16):
        rows = static.batch == graph
        torch.testing.assert_close(
            torch.cdist(new[rows, 0], new[rows, 3]), torch.cdist(history[rows, 0], history[rows, 3])
        )
        torch.testing.assert_close(
            (new_following - new[:, -1])[rows].norm(dim=1), (following - history[:, -1])[rows].norm(dim=1)
        )
        assert torch.equal(new[rows][..., 2], history[rows][..., 2])
        assert torch.equal(scenes.gravity[graph].abs().sort().values, static.gravity[graph].abs().sort().values)
        assert ((new[rows] >= scenes.lower[graph]) & (new[rows] <= scenes.upper[graph])).all()
        along = (following - history[:, -1])[rows] @ static.gravity[graph]
        torch.testing.assert_close((new_following - new[:, -1])[rows] @ scenes.gravity[graph], along, atol=1e-4, rtol=0)
        variants.add((tuple(scenes.gravity[graph].tolist()), tuple(scenes.upper[graph].tolist())))
    assert len(variants) >= 5


def test_two_dimensions_are_mirrored_only() -> None:
    static = make_static(10, graphs=8, gravity=(0.0, -9.81))
    history = torch.rand(80, 3, 2)
    new, _ = sample_symmetry(history, static, make_random(static))
    assert torch.equal(new[..., 1], history[..., 1])
    same = (new[..., 0] == history[..., 0]).all(dim=1)
    torch.testing.assert_close(new[~same][..., 0], 1 - history[~same][..., 0])
    assert 0 < int(same.sum()) < 80


def test_what_is_undone_is_as_it_was() -> None:
    static = make_static(10, graphs=16)
    static.upper[:] = torch.tensor([1.5, 0.5, 0.7])
    position = torch.rand(160, 3, 3) * static.upper[static.batch][:, None]
    symmetry = Symmetry.sample(static, make_random(static), position.dtype)
    turned = symmetry.turned(position, static.batch)
    assert not torch.equal(turned, position)
    torch.testing.assert_close(symmetry.undone(turned, static.batch), position)
    vectors = symmetry.turned(position.diff(dim=1), static.batch, vectors=True)
    torch.testing.assert_close(vectors, turned.diff(dim=1))
