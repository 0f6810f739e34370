"""Settings of the depth-averaged solver, checked at construction."""

from __future__ import annotations

from dataclasses import dataclass

from gns_pl.errors import InputError
from gns_pl.scene.checks import checked_number

COURANT_LIMIT = 0.5
"""Largest Courant number: beyond it the second-order scheme in two dimensions is no longer stable."""

NUM_PARTICLES = {2: 4_096, 3: 32_768}
"""Particles of a trajectory by dimension: so many that fronts and maps of the layer are kept (docs/shallow.md)."""


@dataclass(frozen=True)
class ShallowConfig:
    """How a scene is discretised, and the scalars of the model that may be calibrated.

    Attributes:
        cell_size: wanted edge of a grid cell [m]; each horizontal axis takes the nearest size that divides the box.
        courant: time step over cell / (speed + speed of surface waves), up to `COURANT_LIMIT`.
        friction: coefficient tan δ of every floor; None: of each floor that of its wall, and at most tan φ of the sand.
        friction_factor: on tan δ of every floor, after that limit.
        earth_pressure: horizontal over vertical stress k; 1 as in a liquid.
        rain: height over length of the standing part of a column; what is above falls freely and is added to the layer
            without horizontal momentum (Larrieu, Staron and Hinch 2006). None: nothing rains.
        turbulence: ξ of Voellmy's drag g v² / ξ, v the speed along the ground [m/s²]; None: none.
        num_particles: of the trajectory that is returned; None: `NUM_PARTICLES`.

    Raises:
        InputError: a number out of its range, in one sentence.
    """

    cell_size: float
    courant: float = 0.45
    friction: float | None = None
    friction_factor: float = 1.0
    earth_pressure: float = 1.0
    rain: float | None = None
    turbulence: float | None = None
    num_particles: int | None = None

    def __post_init__(self) -> None:
        for name in ("cell_size", "courant", "friction_factor", "earth_pressure"):
            object.__setattr__(self, name, checked_number("shallow", name, getattr(self, name), 0.0, above=True))
        for name in ("friction", "rain"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, checked_number("shallow", name, getattr(self, name), 0.0))
        if self.turbulence is not None:
            turbulence = checked_number("shallow", "turbulence", self.turbulence, 0.0, above=True)
            object.__setattr__(self, "turbulence", turbulence)
        if self.courant > COURANT_LIMIT:
            raise InputError(f"shallow: courant must be at most {COURANT_LIMIT:g}, not {self.courant:g}.")
        if self.num_particles is not None:
            number = checked_number("shallow", "num_particles", self.num_particles, 1.0)
            if number != int(number):
                raise InputError(f"shallow: num_particles must be a whole number, not {self.num_particles}.")
            object.__setattr__(self, "num_particles", int(number))
