"""Windows, cameras, obstacles and colours, before anything is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.scene import Box, Plane, Wall
from gns_pl.viz.camera import (
    KINEMATIC_GREY,
    camera_of,
    collapse_time,
    colours_of,
    evenly,
    grain_diameters,
    limit_of,
    obstacle_solids,
    values_of,
    window_of,
)
from tests.evaluation.made_up import SPACING, column, moved, spreading, standing

SLIP = Wall("slip")


@pytest.mark.parametrize("dim", [2, 3])
def test_a_camera_sees_its_window_whole_and_straight(dim: int) -> None:
    window = window_of([standing(column(dim))])
    camera = camera_of(window, dim, margin=0.0)
    seen = camera.project(window.corners())
    np.testing.assert_allclose(seen.min(axis=0), 0, atol=1e-6)
    np.testing.assert_allclose(seen.max(axis=0), 1, atol=1e-6)
    lower, upper = camera.project(np.array([[0.7, 0, 0], [0.7, 0, 0.2]]))
    assert upper[1] > lower[1] and (dim == 3 or upper[0] == pytest.approx(lower[0], abs=0.01))
    np.testing.assert_allclose(camera.forward @ np.stack([camera.right, camera.up], axis=1), 0, atol=1e-12)
    assert camera.forward[1] > 0  # x runs to the right, so one looks along y


def test_a_window_ends_above_the_grains_and_below_the_lid() -> None:
    window = window_of([standing()])
    np.testing.assert_allclose(window.lower, 0)
    np.testing.assert_allclose(window.upper, [1.5, 0.5, 0.25])
    thrown = moved(standing(), np.full((5, 3), 9.0))
    assert window_of([standing(), thrown]).upper[2] == 0.7
    lost = moved(standing(), np.full((5, 3), np.nan))
    np.testing.assert_allclose(window_of([lost, standing()]).upper, window.upper)
    flat = window_of([standing(column(2))])
    np.testing.assert_allclose(flat.upper - flat.lower, [1.5, SPACING, 0.25], rtol=1e-6)
    with pytest.raises(InputError, match="different boxes"):
        window_of([standing(), standing(column().replace(upper=(1.6, 0.5, 0.7)))])
    with pytest.raises(InputError, match="no trajectory"):
        window_of([])


def test_obstacles_are_cut_to_the_window() -> None:
    slope = Plane((0.0, 0.0, 0.2), (0.2, 0.0, 1.0), SLIP)  # falls from 0.2 m to nothing over 1 m
    scene = column().replace(
        obstacles=(slope, Box((1.2, 0.1, 0.0), (0.1, 0.3, 0.2), SLIP), Plane((0, 0, -1.0), (0, 0, 1), SLIP))
    )
    window = window_of([standing(scene)])
    solids = obstacle_solids(scene, window)
    volumes = [ConvexHull(points).volume for points, _ in solids]
    assert volumes == pytest.approx([0.5 * 1.0 * 0.2 * 0.5, 0.1 * 0.3 * 0.2], rel=1e-5)
    for points, triangles in solids:
        assert triangles.max() < len(points)
        assert (points > window.lower - 1e-6).all() and (points < window.upper + 1e-6).all()


def test_obstacles_of_a_slice_are_as_thick_as_it() -> None:
    scene = column(2).replace(obstacles=(Plane((0.0, 0.2), (0.2, 1.0), SLIP), Box((1.2, 0.0), (0.1, 0.2), SLIP)))
    solids = obstacle_solids(scene, window_of([standing(scene)]))
    volumes = [ConvexHull(points).volume for points, _ in solids]
    assert volumes == pytest.approx([0.1 * SPACING, 0.02 * SPACING], rel=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_grain_is_as_large_as_what_it_stands_for(dim: int) -> None:
    flow = standing(column(dim))
    np.testing.assert_allclose(grain_diameters(flow), SPACING, rtol=1e-5)
    weightless = replace(flow, mass=np.zeros_like(flow.mass))
    np.testing.assert_allclose(grain_diameters(weightless), SPACING, rtol=1e-5)


def test_colours_mean_displacement_or_speed() -> None:
    pushed = moved(standing(), np.arange(5)[:, None] * [0.03, 0.0, 0.04])
    np.testing.assert_allclose(values_of(pushed, 2, "displacement"), 0.1, rtol=1e-5)
    np.testing.assert_allclose(values_of(pushed, 2, "speed"), 0.05 / pushed.dt, rtol=1e-4)
    np.testing.assert_allclose(values_of(pushed, 0, "speed"), 0)
    assert limit_of(pushed, "displacement") == pytest.approx(0.2, rel=1e-4)
    assert limit_of(pushed, "speed") == pytest.approx(2.5, rel=1e-4)
    assert limit_of(moved(standing(), np.full((5, 3), np.nan)), "speed") > 0
    with pytest.raises(InputError, match="displacement, speed, not 'hue'"):
        values_of(pushed, 0, "hue")


def test_scripted_and_lost_particles_are_grey() -> None:
    flow = spreading()
    types = flow.particle_type.copy()
    types[0] = ParticleType.KINEMATIC
    position = flow.position.copy()
    position[-1, 1] = np.nan
    colours = colours_of(replace(flow, particle_type=types, position=position), -1, "displacement", 0.4)
    assert (colours[:2] == KINEMATIC_GREY).all() and not (colours[2:] == KINEMATIC_GREY).all(axis=1).any()


def test_moments_and_the_time_scale() -> None:
    assert evenly(5, 3) == [0, 2, 4] and evenly(3, 9) == [0, 1, 2] and evenly(1, 4) == [0]
    assert collapse_time(column()) == pytest.approx(np.sqrt(0.2 / 9.81))
    assert collapse_time(column().replace(gravity=(0, 0, 0))) is None
