"""The vocabulary: every stored array's name, shape, unit, dtype and meaning, and the types of particles.

Shapes use the letters of the project: `T` frames, `N` particles, `D` dimension, `K` material features.
No array is made or read here; other rooms take their names from this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class ParticleType(IntEnum):
    """What a particle is; the numbers are those of geoelements/gns, so imported sets keep theirs."""

    KINEMATIC = 3
    """Moves by a script (an obstacle); never integrated."""
    SAND = 6
    """Granular material, moved by the simulator."""


@dataclass(frozen=True)
class Field:
    """One array of a trajectory.

    Attributes:
        name: key under which the array is stored.
        shape: its letters, in order.
        unit: SI unit, "1" if it has none.
        dtype: NumPy name of the stored type.
        meaning: one line for the reader of a file.
    """

    name: str
    shape: tuple[str, ...]
    unit: str
    dtype: str
    meaning: str


POSITION = Field("position", ("T", "N", "D"), "m", "float32", "position of every particle in every frame")
PARTICLE_TYPE = Field("particle_type", ("N",), "1", "int64", "ParticleType of every particle")
MATERIAL = Field("material", ("N", "K"), "1", "float32", "material features of every particle, named by the file")
MASS = Field("mass", ("N",), "kg", "float32", "mass that a particle stands for (per metre of depth if D = 2)")
INITIAL_VELOCITY = Field("initial_velocity", ("N", "D"), "m/s", "float32", "velocity at the first frame")

FIELDS: tuple[Field, ...] = (POSITION, PARTICLE_TYPE, MATERIAL, MASS, INITIAL_VELOCITY)
"""Every array of a trajectory, in the order in which files hold them."""

OBSERVED: tuple[Field, ...] = (
    Field("front", ("T", "Q"), "m", "float32", "distance from the release behind which `percents` of the mass lie"),
    Field(
        "volume_map",
        ("T", "X", "Y"),
        "m3",
        "float32",
        "volume at the nodes of a grid seen from above; D = 2: Y = 1, m2",
    ),
    Field("mean_height", ("T",), "m", "float32", "mass-weighted mean height over the floor"),
    Field("kinetic_energy", ("T",), "J", "float32", "of all points (per metre of depth if D = 2)"),
)
"""Every array of the observables of a whole run, which a trajectory may have."""

MATERIAL_FEATURES: tuple[str, ...] = ("tan_friction_angle",)
"""Names of the K material features a trajectory of ours carries, in order."""
