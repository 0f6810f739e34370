"""Every k-th lattice point: which points are kept, and that the bodies go on weighing what they estimate."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.generation.thinning import drawn_points, kept_points, stored_counts, thin_trajectory
from gns_pl.mpm.settings import place_points
from gns_pl.scene import Body, Box, Material, Plane, Scene, Wall
from gns_pl.trajectory import Trajectory
from tests.generation.fake import FINE, fake_solver

SLOPE = Plane((0, 0, 0.1), (1, 0, 3), Wall("slip"))


@pytest.fixture
def scene(drop: Scene) -> Scene:
    """Two bodies of two densities, one of them a thin layer: 5 x 5 x 5 and 6 x 2 x 5 places at FINE's spacing."""
    light = Material(density=900, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=40)
    plate = Body((0.5, 0.8, 0.1), (0.37, 0.13, 0.31), (0, 0, 0), "light")
    return drop.replace(materials={**drop.materials, "light": light}, bodies=(*drop.bodies, plate))


def run(scene: Scene) -> Trajectory:
    return fake_solver(scene, FINE, frame_interval=0.05, seed=3)


def thin(trajectory: Trajectory, every: int, offset: tuple[int, ...] | None) -> Trajectory:
    return thin_trajectory(trajectory, FINE, 3, every, offset)


@pytest.mark.parametrize("every", [2, 3, 4])
@pytest.mark.parametrize("carved", [False, True])
def test_every_body_keeps_its_mass_and_its_volume(scene: Scene, every: int, carved: bool) -> None:
    scene = scene.replace(obstacles=(SLOPE,)) if carved else scene
    whole = run(scene)
    body = place_points(scene, FINE, 3).body
    for offset in [(0, 0, 0), (1, 0, 1), (every - 1,) * 3]:
        kept = thin(whole, every, offset)
        part = body[kept_points(scene, place_points(scene, FINE, 3), every, offset)]
        for index in (0, 1):
            mass = whole.mass[body == index].sum(dtype=np.float64)
            assert kept.mass[part == index].sum(dtype=np.float64) == pytest.approx(mass, rel=1e-6)
            volume = whole.volume()[body == index].sum(dtype=np.float64)
            assert kept.volume()[part == index].sum(dtype=np.float64) == pytest.approx(volume, rel=1e-6)
            assert len(np.unique(kept.mass[part == index])) == 1


def test_what_is_kept_moves_as_in_the_whole_run(drop: Scene) -> None:
    whole, kept = run(drop), thin(run(drop), 2, (1, 0, 1))
    lattice = place_points(drop, FINE, 3).lattice
    assert lattice.max(axis=0).tolist() == [4, 4, 4]
    wanted = [index for index, place in enumerate(lattice.tolist()) if [p % 2 for p in place] == [1, 0, 1]]
    assert len(wanted) == 2 * 3 * 2
    np.testing.assert_array_equal(kept.position, whole.position[:, wanted])
    for name in ("particle_type", "material", "initial_velocity"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(whole, name)[wanted])
    assert kept.mass == pytest.approx(whole.mass[wanted] * 125 / 12, rel=1e-6)
    assert (kept.dt, kept.scene, kept.num_frames) == (whole.dt, whole.scene, whole.num_frames)
    assert kept.provenance == {**whole.provenance, "every": 2, "offset": [1, 0, 1]}


@pytest.mark.parametrize("every", [2, 3])
def test_the_shifted_lattices_share_the_points_out(drop: Scene, every: int) -> None:
    particles = place_points(drop, FINE, 3)
    kept = [kept_points(drop, particles, every, offset) for offset in product(range(every), repeat=3)]
    assert np.sort(np.concatenate(kept)).tolist() == list(range(125))


def test_every_point_is_the_trajectory_itself(drop: Scene) -> None:
    whole = run(drop)
    assert thin(whole, 1, (0, 0, 0)) is whole


@pytest.mark.parametrize("offset", [0, 1, 2, 3])
def test_a_thin_layer_keeps_one_of_its_layers(scene: Scene, offset: int) -> None:
    particles = place_points(scene, FINE, 3)
    kept = kept_points(scene, particles, 4, (0, offset, 0))
    layers = particles.lattice[kept[particles.body[kept] == 1]]
    assert set(layers[:, 1]) == {offset % 2}
    assert set(layers[:, 0]) == {0, 4}


def test_counts_without_a_simulation(scene: Scene) -> None:
    offsets = {1: (0, 0, 0), 2: (1, 0, 0), 3: None, 4: (3, 1, 2)}
    number, stored = stored_counts(scene, 1 / 16, offsets)
    assert number == stored[1] == 125 + 60
    for every, offset in offsets.items():
        assert stored[every] == thin(run(scene), every, offset).num_particles


def test_refusals(scene: Scene, drop: Scene) -> None:
    with pytest.raises(InputError, match=r"'cube_drop', body 0: has 5 x 5 x 5 lattice places, too few .* every 6"):
        stored_counts(scene, 1 / 16, {6: (0, 0, 0)})
    assert stored_counts(scene, 1 / 16, {5: (0, 0, 0)})[1] == {5: 1 + 2}
    pillars = [Box((0.3 + 0.12 * place, 0.2, 0), (0.06, 0.5, 1), Wall("slip")) for place in range(3)]
    with pytest.raises(InputError, match="body 0: obstacles leave nothing of every 2"):
        stored_counts(drop.replace(obstacles=tuple(pillars)), 1 / 16, {2: (1, 0, 0)})


@pytest.mark.parametrize("changes", [{"seed": 4}, {"mpm": {**FINE, "cell_size": 0.25}}])
def test_a_trajectory_of_another_placement_is_not_cut_up(drop: Scene, changes: dict[str, Any]) -> None:
    arguments: dict[str, Any] = {"mpm": FINE, "seed": 3, "every": 2, "offset": (0, 0, 0)}
    with pytest.raises(ValueError, match="not what these settings and this seed place"):
        thin_trajectory(run(drop), **(arguments | changes))


@pytest.mark.parametrize("every", [2, 3, 4])
@pytest.mark.parametrize("carved", [False, True])
def test_each_block_has_one_point_which_weighs_what_the_block_does(scene: Scene, every: int, carved: bool) -> None:
    scene = scene.replace(obstacles=(SLOPE,)) if carved else scene
    whole, particles = run(scene), place_points(scene, FINE, 3)
    keep, block = drawn_points(scene, particles, every, 3)
    assert (np.diff(keep) > 0).all()
    assert sorted(block[keep]) == np.unique(block).tolist()
    kept = thin(whole, every, None)
    np.testing.assert_array_equal(kept.position, whole.position[:, keep])
    np.testing.assert_allclose(kept.mass, np.bincount(block, weights=whole.mass)[block[keep]], rtol=1e-6)
    assert kept.provenance == {**whole.provenance, "every": every, "sampling": "stratified"}
    for number in np.unique(block):
        inside = particles.lattice[block == number]
        assert len(np.unique(particles.body[block == number])) == 1
        assert (np.ptp(inside, axis=0) < 2 * every).all()
        if not carved:  # a block is a cuboid of as many places as the rounding of n / k allows
            assert len(inside) == np.prod(np.ptp(inside, axis=0) + 1)
    again = drawn_points(scene, particles, every, 3)[0]
    np.testing.assert_array_equal(again, keep)
    assert any(drawn_points(scene, particles, every, seed)[0].tolist() != keep.tolist() for seed in (4, 5))


def test_every_point_of_a_block_is_drawn_equally_often(scene: Scene) -> None:
    particles, draws = place_points(scene, FINE, 3), 3000
    _, block = drawn_points(scene, particles, 2, 0)
    times = np.zeros(len(block))
    for seed in range(draws):
        times[drawn_points(scene, particles, 2, seed)[0]] += 1
    share = 1 / np.bincount(block)[block]
    deviation = (times / draws - share) / np.sqrt(share * (1 - share) / draws + 1e-12)
    assert np.abs(deviation).max() < 4.5  # of 185 points; normal, the odds are 1 in 800
    assert share.min() == 1 / 27  # 5 places in 2 blocks: 3 and 2


def test_blocks_side_by_side_share_the_layers_out(drop: Scene) -> None:
    """Of 5 places in 2 blocks the lower ones have 3 layers and the upper 2; four blocks lie side by side."""
    particles = place_points(drop, FINE, 3)
    for seed in range(20):
        lattice = particles.lattice[drawn_points(drop, particles, 2, seed)[0]]
        for axis in range(3):
            number = np.bincount(lattice[:, axis], minlength=5)
            assert set(number[:3]) == {1, 2} and number[:3].sum() == 4
            assert number[3:].tolist() == [2, 2]
