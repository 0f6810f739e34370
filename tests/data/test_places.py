"""Particles that a training or a run would lose without a word: outside the box, without neighbours, far from zero."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.data.places import check_inside, check_neighbours, check_reach, check_set
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.graph.radius import advised_radius
from gns_pl.rollout.engine import Run, check_run
from gns_pl.trajectory import Trajectory
from tests.conftest import make_simulator
from tests.data.sets import SPACING, make_flight, make_scene, write_set


def flights(number: int = 3) -> list[Trajectory]:
    return [make_flight(make_scene(position=(0.3, 0.3, 0.5 + 0.02 * each)), 9) for each in range(number)]


def checked(folder: Path, trajectories: list[Trajectory], radius: float = 2.1 * SPACING) -> None:
    manifest = write_set(folder, trajectories)
    train, valid = ([folder / name for name in manifest.splits[split]] for split in ("train", "valid"))
    check_set(train, valid, radius=radius, spacing=manifest.spacing)


def in_box(trajectory: Trajectory, **corners: tuple[float, ...]) -> Trajectory:
    """Its scene has another box, which no longer holds its body."""
    scene = trajectory.scene.replace(
        bodies=(replace(trajectory.scene.bodies[0], position=(0.1,) * 3, size=(0.1,) * 3),)
    )
    return replace(trajectory, scene=scene.replace(**corners))


def test_a_sound_set_passes(tmp_path: Path) -> None:
    checked(tmp_path, flights())


def test_a_radius_that_reaches_nobody_is_refused_with_the_one_to_take(tmp_path: Path) -> None:
    """Spacing 0.05 m: the nearest others are 0.05 m away, so that 0.025 m has none."""
    with pytest.raises(
        InputError, match=r"has 0 neighbours .* = 0\.025 m, .*0\.05 m; take model.connectivity_radius=0\.105$"
    ):
        checked(tmp_path, flights(), radius=0.025)


def test_a_radius_that_reaches_everybody_is_refused() -> None:
    """As of data in kilometres: edges of all pairs would fill any memory."""
    check_neighbours(1000.0, radius=1.0, spacing=SPACING)
    with pytest.raises(InputError, match=r"has 1\.33e\+03 neighbours .* take model\.connectivity_radius=0\.105"):
        check_neighbours(1331.0, radius=1.0, spacing=SPACING)


@pytest.mark.parametrize("which", [0, 2], ids=["train", "valid"])
def test_a_box_that_leaves_out_half_is_refused_with_the_number(tmp_path: Path, which: int) -> None:
    """216 particles, x from 0.325 to 0.575: those from 0.475 on, half of them, are outside a box that ends at 0.42."""
    trajectories = flights()
    trajectories[which] = in_box(trajectories[which], upper=(0.42, 1.0, 1.0))
    with pytest.raises(
        InputError, match=r"000\d\.h5: 108 of 216 particles \(50 %\) lie outside the box .*0\.42, 1\.0, 1\.0"
    ):
        checked(tmp_path, trajectories)


def test_stragglers_and_penetrated_walls_pass_and_are_counted() -> None:
    frame = np.full((1, 1000, 2), 0.5)
    frame[0, :5] = 1.5  # five in a thousand
    frame[0, 5:] = 1.04  # less than a spacing beyond the wall
    sentence = check_inside([frame], (0.0, 0.0), (1.0, 1.0), margin=0.05)
    assert sentence.startswith("5 of 1,000 particles (0.5 %) lie outside the box [0.0, 0.0] to [1.0, 1.0]")
    assert check_inside([frame[:, 5:]], (0.0, 0.0), (1.0, 1.0), margin=0.05) == ""
    frame[0, :20] = -0.2
    with pytest.raises(InputError, match=r"20 of 1,000 particles \(2 %\)"):
        check_inside([frame], (0.0, 0.0), (1.0, 1.0), margin=0.05)


def test_kinematic_particles_may_stand_outside() -> None:
    """Walls made of particles do, in sets of others."""
    trajectory = flights(1)[0]
    types = trajectory.particle_type.copy()
    outside = trajectory.position[0, :, 0] > 0.45
    types[outside] = int(ParticleType.KINEMATIC)
    half = in_box(trajectory, upper=(0.42, 1.0, 1.0))
    simulator = make_simulator(particle_types=(3, 6))
    check_run(Run(replace(half, particle_type=types), 2), simulator.config)
    with pytest.raises(InputError, match=r"scene 'made_up': 108 of 216 particles"):
        check_run(Run(half, 2), simulator.config)


def test_a_run_at_a_spacing_beyond_the_radius_is_refused() -> None:
    with pytest.raises(InputError, match=r"stand for 0\.05 m each way, and the simulator's radius is 0\.025 m"):
        check_reach(flights(1)[0], 0.025)


def test_a_set_far_from_zero_is_refused(tmp_path: Path) -> None:
    """As sets were imported before origins were taken off."""
    far = [replace(each, scene=each.scene.replace(upper=(600_001.0, 1.0, 1.0))) for each in flights()]
    with pytest.raises(
        InputError, match=r"reach 6e\+05 m, where float32 numbers are 0\.062 m apart, for particles 0\.05 m"
    ):
        checked(tmp_path, far)


def test_the_advised_radius_is_no_distance_of_a_lattice() -> None:
    distances = np.sqrt(np.unique(np.add.outer(np.arange(5) ** 2, np.add.outer(np.arange(5) ** 2, np.arange(5) ** 2))))
    assert np.abs(advised_radius(0.0208) / 0.0208 - distances).min() > 0.08
    assert advised_radius(1.0) == 2.1 and advised_radius(1 / 24) == 0.0875
