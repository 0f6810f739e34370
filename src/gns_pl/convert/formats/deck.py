"""The JSON input of a CB-Geo MPM run, as far as its files of particles leave things open: time step, box, gravity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.metadata import positive, read_json
from gns_pl.convert.formats.source import Stated, reading
from gns_pl.errors import InputError
from gns_pl.io.regular import regular_size

MOST_MESH_BYTES = 2_000_000_000


@dataclass(frozen=True)
class DeckMaterial:
    """A material of a deck; None where the deck does not say.

    Attributes:
        kind: its model, "MohrCoulomb3D".
        density: [kg/m³].
        friction_angle_deg: [degrees].
    """

    kind: str = ""
    density: float | None = None
    friction_angle_deg: float | None = None


@dataclass(frozen=True)
class Deck:
    """What a deck says; None where it does not.

    Attributes:
        dt: time step of the solver [s].
        lower: lower corner of the mesh [D] [m].
        upper: upper corner of the mesh [D] [m].
        gravity: [D] [m/s²].
        materials: id → material.
        path: of the deck; None where there is none.
        notes: sentences for the report.
    """

    dt: float | None = None
    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    gravity: tuple[float, ...] | None = None
    materials: Mapping[int, DeckMaterial] = field(default_factory=dict)
    path: Path | None = field(default=None, compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)

    def shared(self, name: str) -> float | None:
        """Return what all materials have in common, "density" or "friction_angle_deg"; None if it differs."""
        values = {getattr(material, name) for material in self.materials.values()}
        return values.pop() if len(values) == 1 else None

    def stated(self, step: int | None, first: int) -> Stated:
        """Return what the deck states of a run.

        Args:
            step: solver steps between saved ones; None where there is one saved step.
            first: number of the first saved step.
        """
        dt, notes = None, list(self.notes)
        if self.dt is not None and step is not None:
            dt = step * self.dt
            notes.append(f"the first frame is {(first + 1) * self.dt:g} s after the start of the run")
        return Stated(
            dt=dt,
            lower=self.lower,
            upper=self.upper,
            gravity=self.gravity,
            density=self.shared("density"),
            friction_angle_deg=self.shared("friction_angle_deg"),
            notes=tuple(notes),
        )


def read_deck(path: Path) -> Deck:
    """Read a deck and the mesh it names.

    Raises:
        InputError: a file that cannot be used; it is named.
    """
    content = read_json(path)
    with reading(path):
        notes = []
        mesh, lower, upper = _part(content, "mesh").get("mesh"), None, None
        if isinstance(mesh, str) and mesh and (path.parent / mesh).exists():
            with reading(path.parent / mesh):
                lower, upper = read_mesh_box(path.parent / mesh)
        else:
            notes.append(f"the mesh {mesh} of the deck is not there, so the box is open")
        loads = _part(content, "external_loading_conditions")
        gravity = _numbers(loads["gravity"]) if "gravity" in loads else None
        if gravity is not None and lower is not None and len(gravity) != len(lower):
            raise InputError(f"gravity has {len(gravity)} components, the mesh {len(lower)}.")
        return Deck(
            dt=positive(_part(content, "analysis"), "dt"),
            lower=lower,
            upper=upper,
            gravity=gravity,
            materials=_materials(content.get("materials", [])),
            path=path,
            notes=tuple(notes),
        )


def _materials(materials: Any) -> dict[int, DeckMaterial]:
    if not isinstance(materials, list) or not all(isinstance(each, Mapping) for each in materials):
        raise InputError("materials must be a list of materials.")
    found: dict[int, DeckMaterial] = {}
    for place, each in enumerate(materials):
        number, friction = each.get("id", place), each.get("friction")
        if isinstance(number, bool) or not isinstance(number, int) or number in found:
            raise InputError(f"the id of a material must be a whole number of its own, not {number!r}.")
        if friction is not None and (isinstance(friction, bool) or not 0 <= float(friction) < 90):
            raise InputError(f"friction of material {number} must be degrees from 0 to below 90, not {friction!r}.")
        found[number] = DeckMaterial(
            kind=str(each.get("type", "")),
            density=positive(each, "density"),
            friction_angle_deg=None if friction is None else float(friction),
        )
    return found


def _part(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = content.get(key, {})
    if not isinstance(part, Mapping):
        raise InputError(f"{key} must hold names and values.")
    return part


def _numbers(values: Any) -> tuple[float, ...]:
    numbers = tuple(float(value) for value in values)
    if len(numbers) not in (2, 3) or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"gravity must be two or three finite numbers, not {values!r}.")
    return numbers


def read_mesh_box(path: Path) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the lower and upper corner of a mesh in CB-Geo's text form [m].

    Empty lines, comments behind # and lines with ! do not count; then come the numbers of nodes and elements, the
    nodes' coordinates a line each, and the elements.

    Raises:
        InputError: another form; the caller names the file.
    """
    if regular_size(path) > MOST_MESH_BYTES:
        raise InputError("is too large for a mesh.")
    lower: NDArray[np.float64] | None = None
    upper: NDArray[np.float64] | None = None
    with path.open(encoding="utf-8") as file:
        lines = (line for line in (line.split("#")[0].strip() for line in file if "!" not in line) if line)
        number = int(next(lines, "0").split()[0])
        for count in range(number):
            node = np.array([float(word) for word in next(lines, "").split()])
            if (
                len(node) not in (2, 3)
                or (lower is not None and len(node) != len(lower))
                or not np.isfinite(node).all()
            ):
                raise InputError(f"node {count} of {number} is missing or has other than two or three coordinates.")
            lower = node if lower is None else np.minimum(lower, node)
            upper = node if upper is None else np.maximum(upper, node)
    if lower is None or upper is None or not (lower < upper).all():
        raise InputError("has no nodes that span a box.")
    return tuple(lower.tolist()), tuple(upper.tolist())
