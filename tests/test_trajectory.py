"""Finite differences against closed forms, the ballistic pre-history, and what a trajectory refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import Body, Scene, fill_scene
from gns_pl.trajectory import Trajectory, ballistic_history, start_trajectory

ACCELERATION = np.array([0.5, -1.0, -9.75])


@pytest.fixture
def thrown(drop: Scene) -> Trajectory:
    """Every particle follows x0 + v0 t + a t²/2, in numbers that float32 holds well."""
    start = start_trajectory(drop, fill_scene(drop, 0.1), 0.125, {})
    time = np.arange(7)[:, None, None] * start.dt
    velocity = start.initial_velocity.astype(np.float64)
    position = start.position[0].astype(np.float64) + velocity * time + 0.5 * ACCELERATION * time**2
    return replace(start, position=position.astype(np.float32))


def test_velocity_is_the_mean_over_the_step_before(thrown: Trajectory) -> None:
    velocity = thrown.velocity()
    assert velocity.shape == thrown.position.shape
    assert velocity.dtype == np.float64
    np.testing.assert_array_equal(velocity[0], thrown.initial_velocity)
    for frame in range(1, thrown.num_frames):
        wanted = thrown.initial_velocity + ACCELERATION * (frame - 0.5) * thrown.dt
        np.testing.assert_allclose(velocity[frame], wanted, atol=3e-6)


def test_acceleration_is_exact_for_a_parabola(thrown: Trajectory) -> None:
    acceleration = thrown.acceleration()
    assert len(acceleration) == thrown.num_frames - 1
    np.testing.assert_allclose(acceleration[0], np.broadcast_to(ACCELERATION / 2, acceleration[0].shape), atol=3e-5)
    np.testing.assert_allclose(acceleration[1:], np.broadcast_to(ACCELERATION, acceleration[1:].shape), atol=6e-5)


def test_semi_implicit_euler_with_these_accelerations_gives_the_trajectory_back(thrown: Trajectory) -> None:
    position, velocity = thrown.position[0].astype(np.float64), thrown.velocity()[0]
    for frame, acceleration in enumerate(thrown.acceleration()):
        velocity = velocity + acceleration * thrown.dt
        position = position + velocity * thrown.dt
        np.testing.assert_allclose(position, thrown.position[frame + 1], atol=1e-12)


def test_counts_and_times(thrown: Trajectory) -> None:
    assert (thrown.num_frames, thrown.num_particles) == thrown.position.shape[:2]
    np.testing.assert_allclose(thrown.time, 0.125 * np.arange(7))


@pytest.mark.parametrize("length", [1, 6])
def test_ballistic_history_moves_at_constant_velocity_and_ends_at_the_start(length: int) -> None:
    generator = np.random.default_rng(0)
    position, velocity = generator.uniform(0, 1, (5, 3)), generator.normal(0, 1, (5, 3))
    history = ballistic_history(position, velocity, 0.01, length)
    assert history.shape == (length, 5, 3)
    np.testing.assert_array_equal(history[-1], position)
    for back in range(length):
        np.testing.assert_allclose(history[length - 1 - back], position - back * 0.01 * velocity, atol=1e-15)


def test_start_is_the_filling(drop: Scene) -> None:
    particles = fill_scene(drop, 0.05)
    start = start_trajectory(drop, particles, 0.01, {"made": "here"})
    assert start.num_frames == 1
    np.testing.assert_allclose(start.position[0], particles.position, atol=1e-7)
    np.testing.assert_allclose(start.mass.sum(), 1800 * 0.3**3, rtol=1e-5)
    assert start.provenance == {"made": "here"}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"position": np.zeros((3, 4), np.float32)}, "position must be"),
        ({"position": np.zeros((3, 4, 2), np.float32)}, "position must be"),
        ({"mass": np.zeros(2, np.float32)}, "mass must be"),
        ({"material": np.zeros((27, 2), np.float32)}, "material must be"),
        ({"initial_velocity": np.zeros((27, 2), np.float32)}, "initial_velocity must be"),
        ({"particle_type": np.zeros((27, 1), np.int64)}, "particle_type must be"),
        ({"dt": 0.0}, "dt must be positive"),
        ({"dt": float("nan")}, "dt must be positive"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(thrown: Trajectory, changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        replace(thrown, **changes)  # type: ignore[arg-type]


def test_volumes_are_those_of_the_filling_also_with_two_materials(drop: Scene) -> None:
    light = replace(drop.materials["sand"], density=900)
    second = Body((0.05, 0.05, 0.05), (0.11, 0.12, 0.13), (0.0, 0.0, 0.0), "light")
    scene = drop.replace(materials={**drop.materials, "light": light}, bodies=(*drop.bodies, second))
    particles = fill_scene(scene, 0.04)  # divides none of the edges
    start = start_trajectory(scene, particles, 0.01, {})
    np.testing.assert_allclose(start.volume(), particles.volume, rtol=1e-6)
    assert start.volume().sum() == pytest.approx(0.3**3 + 0.11 * 0.12 * 0.13, rel=1e-5)


def test_a_particle_of_unknown_density_is_refused(drop: Scene) -> None:
    light = replace(drop.materials["sand"], density=900)
    second = Body((0.05, 0.05, 0.05), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), "light")
    scene = drop.replace(materials={**drop.materials, "light": light}, bodies=(*drop.bodies, second))
    start = start_trajectory(scene, fill_scene(scene, 0.05), 0.01, {})
    start.position[0, 0] = 0.9
    with pytest.raises(InputError, match="outside every body"):
        start.volume()


def test_resampling_keeps_its_own_frames_and_follows_the_parabola(thrown: Trajectory) -> None:
    finer = thrown.resampled(thrown.dt / 4)
    assert finer.num_frames == 25 and finer.dt == thrown.dt / 4
    np.testing.assert_array_equal(finer.position[::4], thrown.position)
    time = finer.time[:, None, None]
    exact = thrown.position[0] + thrown.initial_velocity * time + 0.5 * ACCELERATION * time**2
    assert np.abs(finer.position - exact).max() < 0.1 * np.abs(np.diff(thrown.position, axis=0)).max()
    coarser = thrown.resampled(2 * thrown.dt)
    np.testing.assert_array_equal(coarser.position, thrown.position[::2])


def test_resampling_never_overshoots_and_goes_on_at_rest(thrown: Trajectory) -> None:
    bounced = replace(thrown, position=thrown.position.copy())
    bounced.position[3:, :, 2] = thrown.position[3, :, 2]  # hits a floor and stays
    finer = bounced.resampled(0.03, duration=1.2)
    assert finer.num_frames == 41
    assert finer.position[..., 2].min() >= bounced.position[..., 2].min()
    np.testing.assert_array_equal(finer.position[-1], bounced.position[-1])
    single = replace(thrown, position=thrown.position[:1]).resampled(0.1, 0.3)
    assert single.num_frames == 4
    with pytest.raises(InputError, match="interval between frames must be positive"):
        thrown.resampled(0.0)
