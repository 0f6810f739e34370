"""The vocabulary names every array of a trajectory once, in types and shapes that exist."""

from __future__ import annotations

import numpy as np

from gns_pl.fields import FIELDS, MATERIAL_FEATURES, POSITION, ParticleType
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from tests.conftest import make_moving


def test_names_are_those_of_a_trajectory() -> None:
    names = [field.name for field in FIELDS]
    assert len(set(names)) == len(names)
    assert set(names) <= set(Trajectory.__dataclass_fields__)
    assert [field.name for field in FIELDS if "T" in field.shape] == [POSITION.name]


def test_types_and_shapes_are_what_a_trajectory_has(drop: Scene) -> None:
    trajectory = make_moving(drop, frames=3, spacing=0.1)
    sizes = {"T": 3, "N": trajectory.num_particles, "D": 3, "K": len(MATERIAL_FEATURES)}
    for field in FIELDS:
        array = getattr(trajectory, field.name)
        assert array.dtype == np.dtype(field.dtype)
        assert array.shape == tuple(sizes[letter] for letter in field.shape)


def test_particle_types_keep_their_numbers() -> None:
    assert (ParticleType.KINEMATIC, ParticleType.SAND) == (3, 6)
