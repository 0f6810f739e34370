"""What neighbours have in common of their errors, by column: means, and what grows with height."""

from __future__ import annotations

import torch

from gns_pl.fields import ParticleType
from gns_pl.graph import ColumnMeans
from tests.conftest import make_static

RADIUS = 0.07


def test_errors_in_common_count_in_full_and_those_of_each_alone_hardly() -> None:
    """What all share counts once for each, and so does what grows with height; of the rest hardly anything is left."""
    draw = torch.Generator().manual_seed(3)
    static = make_static(2000, graphs=2)
    position = torch.rand(4000, 3, generator=draw)
    columns, way = ColumnMeans(position, static, RADIUS), torch.tensor([1.0, 2.0, 0.0])
    torch.testing.assert_close(columns.square(way.expand(4000, 3)), torch.tensor(4000 * 5.0), rtol=1e-4, atol=0)
    stretched = (position[:, 2:] - 0.5) * way
    torch.testing.assert_close(columns.square(stretched), stretched.square().sum(), rtol=1e-4, atol=0)
    alone = torch.randn(4000, 3, generator=draw)
    assert float(columns.square(alone)) < 0.04 * float(alone.square().sum())


def test_columns_of_two_scenes_are_apart() -> None:
    """Errors that would cancel each other out stand in two boxes."""
    position = torch.rand(500, 3, generator=torch.Generator().manual_seed(5))
    columns = ColumnMeans(torch.cat([position, position]), make_static(500, graphs=2), RADIUS)
    error = torch.cat([torch.ones(500, 3), -torch.ones(500, 3)])
    torch.testing.assert_close(columns.square(error), torch.tensor(3000.0), rtol=1e-4, atol=0)


def test_kinematic_particles_have_no_part_in_the_means() -> None:
    static = make_static(100)
    static.particle_type[::2] = int(ParticleType.KINEMATIC)
    position = torch.rand(100, 3, generator=torch.Generator().manual_seed(4))
    columns = ColumnMeans(position, static, RADIUS)
    torch.testing.assert_close(columns.square(torch.ones(50, 3)), torch.tensor(150.0), rtol=1e-4, atol=0)
