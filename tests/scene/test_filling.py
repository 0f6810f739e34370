"""Particles fill a body exactly: volumes add up, jitter stays in its cell, and the same seed gives the same places."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.scene import FACES, Body, Box, Material, Plane, Scene, Wall, fill_scene, signed_distance

SANDS = {"light": Material(1000, 1e6, 0.3, 20), "heavy": Material(2000, 1e6, 0.3, 40)}


@pytest.fixture
def two() -> Scene:
    bodies = (
        Body((0.1, 0.2, 0.0), (0.31, 0.2, 0.1), (1, 2, 3), "heavy"),
        Body((0.5, 0.5, 0.5), (0.2, 0.2, 0.2), (0, 0, -1), "light"),
    )
    walls = {face: Wall("slip") for face in FACES[3]}
    return Scene("two", (0, 0, 0), (1, 1, 1), (0, 0, -9.81), 1, SANDS, bodies, walls)


@pytest.mark.parametrize("spacing", [0.02, 0.033, 0.07, 1.0])
def test_volumes_and_masses_add_up(two: Scene, spacing: float) -> None:
    particles = fill_scene(two, spacing)
    heavy = particles.material_name == 1
    assert particles.volume.sum() == pytest.approx(0.31 * 0.2 * 0.1 + 0.2**3)
    assert particles.mass[heavy].sum() == pytest.approx(2000 * 0.31 * 0.2 * 0.1)
    assert particles.mass[~heavy].sum() == pytest.approx(1000 * 0.2**3)


def test_each_body_has_its_velocity_material_and_place(two: Scene) -> None:
    particles = fill_scene(two, 0.05)
    heavy = particles.material_name == 1
    assert heavy.sum() == 6 * 4 * 2
    assert (~heavy).sum() == 4**3
    for body, mask in ((two.bodies[0], heavy), (two.bodies[1], ~heavy)):
        assert (particles.velocity[mask] == body.velocity).all()
        np.testing.assert_allclose(particles.position[mask].mean(axis=0), np.add(body.position, body.upper) / 2)
        assert (particles.position[mask] > body.position).all()
        assert (particles.position[mask] < body.upper).all()
    np.testing.assert_allclose(particles.material[heavy], SANDS["heavy"].tan_friction_angle, rtol=1e-6)
    assert (particles.particle_type == ParticleType.SAND).all()


@pytest.mark.parametrize("jitter", [0.3, 0.7, 0.999])
def test_jitter_is_bounded_and_used(two: Scene, jitter: float) -> None:
    lattice, jittered = fill_scene(two, 0.05), fill_scene(two, 0.05, jitter=jitter, generator=np.random.default_rng(0))
    heavy = lattice.material_name == 1
    cell = np.where(heavy[:, None], [0.31 / 6, 0.05, 0.05], 0.05)
    offset = np.abs(jittered.position - lattice.position) / (cell / 2)
    assert offset.max() <= jitter + 1e-9
    assert offset.max() > 0.95 * jitter


def test_the_same_seed_gives_the_same_places(two: Scene) -> None:
    def fill(seed: int) -> np.ndarray:
        return fill_scene(two, 0.05, jitter=0.7, generator=np.random.default_rng(seed)).position

    np.testing.assert_array_equal(fill(1), fill(1))
    assert (fill(1) != fill(2)).any()


def test_every_particle_knows_its_place_in_its_bodys_lattice(two: Scene) -> None:
    particles = fill_scene(two, 0.05)
    np.testing.assert_array_equal(particles.body == 0, particles.material_name == 1)
    for index, count in ((0, (6, 4, 2)), (1, (4, 4, 4))):
        body, mine = two.bodies[index], particles.body == index
        cell = np.array(body.size) / count
        np.testing.assert_allclose(particles.position[mine], body.position + (particles.lattice[mine] + 0.5) * cell)


@pytest.mark.parametrize("jitter", [0.0, 0.7])
def test_obstacles_carve_bodies_and_leave_the_rest_alone(two: Scene, jitter: float) -> None:
    slope = Plane((0.25, 0.3, 0.05), (1, 0, 2), Wall("slip"))
    block = Box((0.6, 0.6, 0.0), (0.5, 0.5, 0.62), Wall("slip"))
    whole, carved = (
        fill_scene(scene, 0.01, jitter=jitter, generator=np.random.default_rng(3))
        for scene in (two, two.replace(obstacles=(slope, block)))
    )
    free = (signed_distance(slope, whole.position)[0] >= 0) & (signed_distance(block, whole.position)[0] >= 0)
    assert 0.3 < free.mean() < 0.8
    for name, values in vars(whole).items():
        np.testing.assert_array_equal(getattr(carved, name), values[free], err_msg=name)
    # Half of the first body lies above the slope, and 0.1 · 0.1 · 0.12 m³ of the second in the block.
    left = [carved.volume[carved.body == index].sum() for index in (0, 1)]
    assert left == pytest.approx([0.31 * 0.2 * 0.1 / 2, 0.2**3 - 0.1 * 0.1 * 0.12], rel=0.06)


def test_bodies_of_which_nothing_is_left_are_refused(two: Scene) -> None:
    halves = tuple(Box((x, 0, 0), (0.5, 1, 0.3), Wall("slip")) for x in (-0.3, 0.2))
    with pytest.raises(InputError, match=r"body 0: obstacles leave nothing of it at a spacing of 0\.05 m"):
        fill_scene(two.replace(obstacles=halves), 0.05)


@pytest.mark.parametrize(
    ("spacing", "jitter", "sentence"),
    [
        (0, 0, "spacing must be positive"),
        (float("nan"), 0, "spacing must be positive"),
        (float("inf"), 0, "spacing must be positive"),
        (0.1, 1.0, "jitter must lie in"),
        (0.1, -0.1, "jitter must lie in"),
        (0.1, 0.5, "needs a random generator"),
        (1e-4, 0, "choose a larger spacing"),
    ],
)
def test_fillings_that_make_no_sense_are_refused(two: Scene, spacing: float, jitter: float, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        fill_scene(two, spacing, jitter=jitter)
