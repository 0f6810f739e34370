"""What the user says of a foreign set, checked as far as it can be without the set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gns_pl.convert.material_value import check_material_value
from gns_pl.errors import InputError

OF_RECORDINGS = ("dt", "lower", "upper", "gravity", "spacing")
"""What every recording may state of itself."""


@dataclass(frozen=True)
class Given:
    """What the user says, in the source's units and axes; None leaves it to the source.

    Attributes:
        dt: time between frames [s].
        scale: metres in the source's unit of length.
        gravity: magnitude [m/s²].
        gravity_axis: "x", "y", "z", or the number of the axis.
        lower: lower corner of the box [D].
        upper: upper corner of the box [D].
        spacing: of neighbouring particles.
        types: particle types of the source → ours, where they differ.
        material_value: what a material value of unknown meaning is: "tan" φ, φ in "degrees" or "radians", "phi/70", or
            "none" to leave it out.
    """

    dt: float | None = None
    scale: float | None = None
    gravity: float | None = None
    gravity_axis: str | int | None = None
    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    spacing: float | None = None
    types: Mapping[int, int] = field(default_factory=dict)
    material_value: str | None = None

    def __post_init__(self) -> None:
        for name in ("dt", "scale", "spacing"):
            value = getattr(self, name)
            if value is not None and not (_is_number(value) and 0 < value < math.inf):
                raise InputError(f"{name} must be a positive number, not {value!r}.")
        if self.gravity is not None and not (_is_number(self.gravity) and 0 <= self.gravity < math.inf):
            raise InputError(f"gravity must be its magnitude, a number that is not negative, not {self.gravity!r}.")
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if value is not None:
                if isinstance(value, str) or not all(map(_is_number, value)):
                    raise InputError(f"{name} must be a list of numbers, not {value!r}.")
                object.__setattr__(self, name, tuple(map(float, value)))
        try:
            types = {int(key): int(value) for key, value in dict(self.types or {}).items()}
        except (TypeError, ValueError):
            raise InputError(f"types must map numbers to numbers, as types={{0:6}}, not {self.types!r}.") from None
        object.__setattr__(self, "types", types)
        if self.material_value is not None:
            check_material_value(self.material_value)

    @property
    def for_all(self) -> tuple[str, ...]:
        """Names of what holds for all recordings, whatever they state of themselves."""
        return tuple(name for name in OF_RECORDINGS if getattr(self, name) is not None)


def axis_number(wanted: str | int, dim: int) -> int:
    """Return the number of an axis that is named or numbered; in two dimensions z is the second.

    Raises:
        InputError: no axis.
    """
    names = {name: number for number, name in enumerate("xyz"[:dim])}
    if dim == 2:
        names["z"] = 1
    number = wanted if isinstance(wanted, int) else names.get(wanted)
    if isinstance(wanted, bool) or number is None or not 0 <= number < dim:
        raise InputError(f"gravity_axis must be one of {', '.join(names)}, not {wanted!r}.")
    return number


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
