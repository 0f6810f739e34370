"""Volume on a grid against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.metrics.maps import map_error, thickness_map, volume_map
from gns_pl.scene import Body, Scene, fill_scene
from tests.evaluation.made_up import column

CELL = 0.1


def filled(scene: Scene, spacing: float = 0.025) -> tuple[np.ndarray, np.ndarray]:
    particles = fill_scene(scene, spacing)
    return particles.position, particles.volume


@pytest.mark.parametrize("dim", [2, 3])
def test_the_map_holds_the_whole_volume_wherever_particles_are(dim: int) -> None:
    generator = np.random.default_rng(3)
    scene = column(dim)
    position = generator.uniform(-0.2, 1.7, (500, dim))  # some of them outside of the box
    volume = generator.uniform(0.5, 2.0, 500)
    assert volume_map(position, volume, scene, 0.07).sum() == pytest.approx(volume.sum(), rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_layer_is_as_thick_as_it_is_high(dim: int) -> None:
    scene = column(dim, length=1.5, height=0.2)
    thickness = thickness_map(*filled(scene), scene, CELL)
    assert thickness.shape == ((16,) if dim == 2 else (16, 6))
    np.testing.assert_allclose(thickness, 0.2, rtol=1e-9)


def test_a_particle_is_shared_by_the_nodes_around_it() -> None:
    scene = column(3)
    volumes = volume_map(np.array([[0.325, 0.11, 9.0]]), np.array([8.0]), scene, CELL)
    assert volumes[3, 1] == pytest.approx(8 * 0.75 * 0.9) and volumes[4, 2] == pytest.approx(8 * 0.25 * 0.1)
    assert np.count_nonzero(volumes > 1e-12) == 4


def test_the_error_is_the_share_that_would_have_to_be_carried() -> None:
    one = np.array([[3.0, 1.0], [0.0, 0.0]])
    assert map_error(one, one) == 0
    assert map_error(np.array([[2.0, 2.0], [0.0, 0.0]]), one) == pytest.approx(0.25)
    assert map_error(np.array([[0.0, 0.0], [4.0, 0.0]]), one) == 1


def test_particles_of_another_size_give_the_same_map_and_a_shift_its_error() -> None:
    block = Body((0.3, 0.1, 0.0), (0.4, 0.3, 0.2), (0.0, 0.0, 0.0))
    scene = column(3).replace(bodies=(block,))
    fine, coarse = (volume_map(*filled(scene, spacing), scene, CELL) for spacing in (0.0125, 0.05))
    assert map_error(coarse, fine) < 1e-9
    position, volume = filled(scene, 0.0125)
    shifted = volume_map(position + np.array([0.1, 0.0, 0.0]), volume, scene, CELL)
    assert map_error(shifted, fine) == pytest.approx(0.1 / 0.4, rel=1e-9)  # of a block of 0.4 m, 0.1 m is elsewhere
