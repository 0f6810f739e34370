"""What colours mean: the displacement, or a particle's material where a scene has several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.fields import ParticleType
from gns_pl.scene import Body, Scene, Wall
from gns_pl.scene.definition import FACES
from gns_pl.trajectory import Trajectory
from gns_pl.viz.colouring import GREY, MATERIALS, OUTSIDE, Colouring, material_names, material_numbers
from gns_pl.viz.evolution import snapshot_times, stands_on_floor
from tests.evaluation.made_up import SAND, moved, spreading, standing


def two_sands(number: int = 2) -> Trajectory:
    """Cubes of several materials in a row, on the floor, at rest."""
    materials = {f"sand {index}": replace(SAND, friction_angle_deg=20.0 + index) for index in range(number)}
    bodies = tuple(
        Body((0.1 + 0.2 * index, 0.1, 0.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), name)
        for index, name in enumerate(materials)
    )
    walls = {face: Wall("slip") for face in FACES[3]}
    upper = (0.3 + 0.2 * number, 0.5, 0.5)
    return standing(Scene("sands", (0.0,) * 3, upper, (0.0, 0.0, -9.81), 1.0, materials, bodies, walls))


def test_displacement_runs_from_nothing_to_what_all_but_one_in_a_hundred_stay_below() -> None:
    flow = spreading()
    colouring = Colouring.of(flow)
    assert colouring.names == () and colouring.legend() == []
    assert (colouring.shares(flow, 0) == 0).all()
    last = colouring.shares(flow, flow.num_frames - 1)
    moved_by = np.linalg.norm(flow.position[-1].astype(np.float64) - flow.position[0], axis=1)
    assert colouring.limit == pytest.approx(np.percentile(moved_by, 99))
    np.testing.assert_allclose(last, np.minimum(moved_by / colouring.limit, 1))
    order = np.argsort(moved_by)
    assert (np.diff(last[order]) >= 0).all()


def test_every_material_has_one_colour_that_stays_with_its_particles() -> None:
    flow = two_sands()
    away = moved(flow, np.linspace(0, 0.2, 5)[:, None] * np.array([1.0, 0.0, 0.0]))
    colouring = Colouring.of(away)
    assert colouring.legend() == [("sand 0", MATERIALS[0]), ("sand 1", MATERIALS[1])]
    left = away.position[0, :, 0] < 0.25
    for frame in (0, 4):
        pixels = colouring.pixels(away, frame)
        for half, colour in ((left, MATERIALS[0]), (~left, MATERIALS[1])):
            assert {tuple(pixel) for pixel in pixels[half]} == {tuple(bytes.fromhex(colour[1:]))}


def test_kinematic_particles_are_grey() -> None:
    flow = spreading()
    types = flow.particle_type.copy()
    types[::3] = int(ParticleType.KINEMATIC)
    mixed = replace(flow, particle_type=types)
    colouring = Colouring.of(mixed)
    assert (colouring.shares(mixed, 3)[::3] == OUTSIDE).all() and (colouring.shares(mixed, 3)[1::3] >= 0).all()
    assert {tuple(pixel) for pixel in colouring.pixels(mixed, 3)[::3]} == {tuple(bytes.fromhex(GREY[1:]))}


@pytest.mark.parametrize(("number", "told_apart"), [(1, 0), (2, 2), (6, 6), (7, 0)])
def test_one_material_or_more_than_there_are_colours_are_not_told_apart(number: int, told_apart: int) -> None:
    assert len(material_names(two_sands(number))) == told_apart


def test_a_particle_just_outside_its_body_is_of_it_and_one_far_away_of_none() -> None:
    flow = two_sands()
    position = flow.position.copy()
    first = int(np.argmin(position[0, :, 0]))
    position[:, first, 0] = 0.1 - 0.4 * flow.spacing
    position[:, first + 1] = (0.45, 0.45, 0.45)
    strayed = replace(flow, position=position)
    number = material_numbers(strayed, ("sand 0", "sand 1"))
    assert number[first] == 0
    assert number[first + 1] == -1


def test_rows_of_a_figure_rise_to_the_end_and_none_is_like_the_next() -> None:
    assert snapshot_times([2.0, 0.0, 1.0], 4.0) == [0.0, 1.0, 2.0, 4.0]
    assert snapshot_times([0.0, 0.1, 1.0, 3.9, 4.0, 9.0, -1.0], 4.0) == [0.0, 1.0, 4.0]
    assert snapshot_times([], 4.0) == [4.0]
    rows = snapshot_times(list(np.linspace(0, 4, 100)), 4.0)
    assert (np.diff(rows) >= 0.05 * 4.0 - 1e-12).all() and rows[-1] == 4.0


def test_a_surface_fails_only_of_what_stands_under_its_weight() -> None:
    scene = standing().scene
    assert stands_on_floor(scene, 0.05)
    body = scene.bodies[0]
    lifted = replace(body, position=(*body.position[:-1], 0.2))
    assert not stands_on_floor(scene.replace(bodies=(lifted,)), 0.05)
    assert not stands_on_floor(scene.replace(gravity=(0.0, 0.0, 0.0)), 0.05)
