"""What is stored of whole runs: the measures themselves, whatever the blocks in which frames come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.fields import OBSERVED, ParticleType
from gns_pl.metrics.maps import volume_map
from gns_pl.metrics.measures import centre_of_mass, kinetic_energy, percentile_front
from gns_pl.metrics.observables import PERCENTS, Observer, compute_observables, fronts
from gns_pl.metrics.release import front_advance
from gns_pl.rollout import rollout
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from tests.conftest import make_moving, make_simulator


@pytest.mark.parametrize("scene_name", ["drop", "column"])
def test_they_are_the_measures_of_every_frame(scene_name: str, request: pytest.FixtureRequest) -> None:
    trajectory = make_moving(request.getfixturevalue(scene_name), frames=5, spacing=0.06)
    observed = compute_observables(trajectory, 0.11)
    np.testing.assert_allclose(observed.mean_height, centre_of_mass(trajectory)[:, -1], rtol=1e-6)
    np.testing.assert_allclose(observed.kinetic_energy, kinetic_energy(trajectory), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        observed.advance()[:, PERCENTS.index(99.0)], front_advance(trajectory), rtol=0, atol=2e-7
    )
    for frame, position in enumerate(trajectory.position):
        wanted = volume_map(position.astype(np.float64), trajectory.volume(), trajectory.scene, observed.cell)
        np.testing.assert_allclose(observed.volume_map[frame], wanted, rtol=1e-6, atol=1e-12)
    for field in OBSERVED:
        assert getattr(observed, field.name).dtype == np.dtype(field.dtype)


def test_frames_in_blocks_are_the_same_and_obstacles_are_not_part_of_them(drop: Scene) -> None:
    flow = make_moving(drop, frames=7, spacing=0.1)
    observer = Observer(replace(flow, position=flow.position[:1]), 0.2)
    for block in (flow.position[:3], flow.position[3:4], flow.position[4:]):
        observer.add(block)
    whole, parts = compute_observables(flow, 0.2), observer.observables()
    fixed = np.repeat(np.array([[[0.9, 0.9, 0.9]]], np.float32), 7, axis=0)
    with_obstacle = Trajectory(
        position=np.concatenate([fixed, flow.position], axis=1),
        particle_type=np.concatenate([[ParticleType.KINEMATIC], flow.particle_type]),
        material=np.concatenate([flow.material[:1], flow.material]),
        material_features=flow.material_features,
        mass=np.concatenate([flow.mass[:1], flow.mass]),
        initial_velocity=np.concatenate([np.zeros((1, 3)), flow.initial_velocity]),
        dt=flow.dt,
        scene=flow.scene,
        provenance={},
    )
    for field in OBSERVED:
        wanted = getattr(whole, field.name)
        np.testing.assert_array_equal(getattr(parts, field.name), wanted)
        np.testing.assert_array_equal(getattr(compute_observables(with_obstacle, 0.2), field.name), wanted)


@pytest.mark.parametrize("number", [1, 2, 30, 2000])
def test_a_front_depends_on_what_is_near_it_alone(number: int) -> None:
    generator = np.random.default_rng(number)
    for width in (1e-3, 0.05, 3.0):
        distance, mass = generator.exponential(1, number), generator.uniform(0.5, 2, number)
        percents = (0.5, 50.0, 90.0, 99.0, 99.9, 100.0)
        wanted = percentile_front(distance[None], mass, percents, width)[:, 0]
        np.testing.assert_allclose(fronts(distance, mass, percents, width), wanted, rtol=0, atol=1e-10)


def test_they_follow_the_frames_of_a_trajectory_or_are_refused(drop: Scene) -> None:
    trajectory = make_moving(drop, frames=7, spacing=0.1)
    trajectory = replace(trajectory, observables=compute_observables(trajectory, 0.2))
    third = trajectory.every(3)
    assert third.observables is not None and trajectory.observables is not None
    np.testing.assert_array_equal(third.observables.front, trajectory.observables.front[[0, 3, 6]])
    assert trajectory.every(1).observables is trajectory.observables
    assert trajectory.resampled(0.004).observables is None
    predicted = rollout(make_simulator(spacing=0.1, connectivity_radius=0.21), trajectory, 6)
    assert predicted.num_frames == 7 and predicted.observables is None
    with pytest.raises(InputError, match="observables must be of 2 frames, not 7"):
        replace(trajectory, position=trajectory.position[:2])
