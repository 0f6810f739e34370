"""The JSON input of a CB-Geo MPM run, as far as its files of particles leave things open: time step, box, gravity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.io.convert.metadata import MOST_BYTES, positive, read_json
from gns_pl.io.convert.source import reading

MOST_MESH_BYTES = 2_000_000_000


@dataclass(frozen=True)
class Deck:
    """What a deck says; None where it does not.

    Attributes:
        dt: time step of the solver [s].
        lower: lower corner of the mesh [D] [m].
        upper: upper corner of the mesh [D] [m].
        gravity: [D] [m/s²].
        density: of the only material [kg/m³].
        friction_angle_deg: of the only material [degrees].
        notes: sentences for the report.
    """

    dt: float | None = None
    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    gravity: tuple[float, ...] | None = None
    density: float | None = None
    friction_angle_deg: float | None = None
    notes: tuple[str, ...] = ()


def find_deck(folder: Path) -> Path | None:
    """Return the only deck in a folder or, if it has none, in one of the three over it; None where there is none.

    Raises:
        InputError: several in one folder.
    """
    for place in [folder, *folder.absolute().parents[:3]]:
        found = [path for path in sorted(place.glob("*.json")) if _is_deck(path)]
        if len(found) > 1:
            raise InputError(f"{place}: has {len(found)} decks; say which one: deck={found[0]}")
        if found:
            return found[0]
    return None


def _is_deck(path: Path) -> bool:
    try:
        return path.stat().st_size <= MOST_BYTES and {"analysis", "mesh"} <= set(read_json(path))
    except (InputError, OSError):
        return False


def read_deck(path: Path) -> Deck:
    """Read a deck and the mesh it names.

    Raises:
        InputError: a file that cannot be used; it is named.
    """
    content = read_json(path)
    with reading(path):
        notes = []
        mesh, lower, upper = _part(content, "mesh").get("mesh"), None, None
        if isinstance(mesh, str) and (path.parent / mesh).is_file():
            with reading(path.parent / mesh):
                lower, upper = read_mesh_box(path.parent / mesh)
        else:
            notes.append(f"the mesh {mesh} of the deck is not there, so the box is open")
        loads = _part(content, "external_loading_conditions")
        gravity = _numbers(loads["gravity"]) if "gravity" in loads else None
        if gravity is not None and lower is not None and len(gravity) != len(lower):
            raise InputError(f"gravity has {len(gravity)} components, the mesh {len(lower)}.")
        materials = content.get("materials", [])
        material = materials[0] if isinstance(materials, list) and len(materials) == 1 else {}
        if isinstance(materials, list) and len(materials) > 1:
            notes.append(f"the deck has {len(materials)} materials, of which none is taken over")
        friction = positive(material, "friction") if material.get("friction") else None
        return Deck(
            dt=positive(_part(content, "analysis"), "dt"),
            lower=lower,
            upper=upper,
            gravity=gravity,
            density=positive(material, "density"),
            friction_angle_deg=friction,
            notes=tuple(notes),
        )


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

    Lines that begin with # and empty ones do not count; then come the numbers of nodes and elements, the nodes'
    coordinates a line each, and the elements.

    Raises:
        InputError: another form; the caller names the file.
    """
    if path.stat().st_size > MOST_MESH_BYTES:
        raise InputError("is too large for a mesh.")
    lower: NDArray[np.float64] | None = None
    upper: NDArray[np.float64] | None = None
    with path.open(encoding="utf-8") as file:
        lines = (line for line in (line.split("#")[0].strip() for line in file) if line)
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
