"""CB-Geo MPM: a folder with a file of particles for each saved step, `particles<STEP>.h5`, and the run's JSON deck.

Each file holds one table; with several ranks a step has a file of each, which are joined. Columns are found by name,
rows by the particle's id: they come in the order of storage, and a particle that left the mesh has none. The first
saved step is one solver step after the start; where the particles were then is their place less their displacement.
Velocities in the table are those of the grid, so that differences of the places are used instead; in the first file
of a run that was held or resumed they are all there is (`_initial_velocity`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.cb_geo_runs import Run, find_runs, read_run
from gns_pl.convert.formats.cb_geo_table import count_rows, has_vector, read_ids, read_table, vector
from gns_pl.convert.formats.deck import Deck
from gns_pl.convert.formats.deck_search import decks_of
from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.source import ForeignSet, Recording, Stated, reading, without_material
from gns_pl.convert.formats.stated import stated_of_all
from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES, ParticleType
from gns_pl.io import MANIFEST_NAME

LOST = ("refuse", "drop")
CONTRADICTION = 0.1
"""Share of the velocities by which the displacements of the first step may be off before they say something else."""


@dataclass(frozen=True)
class Presence:
    """Which particles of a run are there when.

    Attributes:
        ids: of those in all files, rising.
        num_first: in the first file.
        num_left: of the first file that are missing in a later one.
        num_came: that are in a later file and not in the first.
    """

    ids: NDArray[np.int64]
    num_first: int
    num_left: int
    num_came: int


def open_cb_geo(path: Path, folders: list[Path], *, deck: Path | None, lost: str) -> ForeignSet:
    """Return the runs of folders, a trajectory each.

    Args:
        path: as the user named it.
        folders: of the runs.
        deck: JSON input of all runs; None looks for that of each, in its folder and over it.
        lost: "refuse" runs whose particles become fewer or more, or "drop" those particles from all frames.

    Raises:
        InputError: files or a deck that cannot be used, or runs that no data set can hold together.
    """
    if lost not in LOST:
        raise InputError(f"lost must be one of {', '.join(LOST)}, not {lost!r}.")
    runs = [read_run(folder, path) for folder in folders]
    decks, notes = decks_of(runs, path, deck)
    names = tuple((run.split, run.name) for run in runs)
    each = [_stated(run, deck) for run, deck in zip(runs, decks, strict=True)]
    if not any(deck.dt for deck in decks) and len({run.step for run in runs if run.step}) > 1:
        raise InputError(f"{path}: its runs were saved every so many steps, not all the same; convert them one by one.")
    stated = stated_of_all(path, [name for _, name in names], each)
    presence = functools.cache(lambda number: _presence(runs[number]))

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(runs[number], decks[number], each[number], lambda: presence(number), lost)

    return ForeignSet("CB-Geo MPM", path, names, opener, replace(stated, notes=(*notes, *stated.notes)), si=True)


def _stated(run: Run, deck: Deck) -> Stated:
    """Return what a run says by its deck and its first file."""
    first = next(iter(run.steps))
    with reading(run.folder):
        rows = read_table(run.steps[first])
    stated = deck.stated(run.step, first)
    spacing, density = None, stated.density
    if "volume" in (rows.dtype.names or ()) and len(rows) and (rows["volume"] > 0).all():
        spacing = float(f"{np.median(rows['volume']) ** (1 / _dim(deck, [rows])):.6g}")
        if density is None and deck.materials and "mass" in (rows.dtype.names or ()):
            density = float(f"{rows['mass'].sum() / rows['volume'].sum():.6g}")
    return replace(
        stated,
        spacing=spacing if spacing is not None and np.isfinite(spacing) else None,
        density=density if density is not None and np.isfinite(density) and density > 0 else None,
    )


def _dim(deck: Deck, tables: list[NDArray[Any]]) -> int:
    """Return D: by the mesh, by gravity, or by whether all particles lie in the plane z = 0."""
    stated = deck.lower or deck.gravity
    if stated is not None:
        return len(stated)
    return 2 if all((rows["coord_z"] == 0).all() for rows in tables) else 3


def _presence(run: Run) -> Presence:
    """Return which particles are there throughout; where their number changes, by a look into all files."""
    every = list(run.steps.values())
    first = throughout = seen = read_ids(every[0])
    constant = all(count_rows(files) == len(first) for files in every)
    if constant and np.array_equal(read_ids(every[-1]), first):
        return Presence(first, len(first), 0, 0)  # `_frame` finds whoever is away in between
    for files in every[1:]:
        these = read_ids(files)
        if not np.array_equal(these, first):
            throughout, seen = np.intersect1d(throughout, these), np.union1d(seen, these)
    return Presence(throughout, len(first), len(first) - len(throughout), len(seen) - len(first))


@contextmanager
def _open(run: Run, deck: Deck, stated: Stated, presence: Callable[[], Presence], lost: str) -> Iterator[Recording]:
    steps = list(run.steps)
    first, last = read_table(run.steps[steps[0]]), read_table(run.steps[steps[-1]])
    there = presence()
    notes = []
    if there.num_left or there.num_came:
        left = f"{there.num_left} of {there.num_first} particles left the mesh" if there.num_left else ""
        came = f"{there.num_came} particles appear after the first frame" if there.num_came else ""
        both = " and ".join(filter(None, (left, came)))
        if lost == "refuse":
            raise InputError(
                f"{both}, and a trajectory has the same ones in all frames; with lost=drop the {len(there.ids)} that "
                "are there throughout are kept, without the others that push them."
            )
        notes.append(f"{both}; these are left out, though they push the others")
    if not len(there.ids):
        raise InputError("no particle is there from beginning to end.")
    ids, dim = there.ids, _dim(deck, [first, last])
    rows = first[np.searchsorted(first["id"], ids)]

    def read(start: int, stop: int) -> NDArray[Any]:
        return np.stack([_frame(run.steps[step], ids, dim) for step in steps[start:stop]])

    material, material_note = _tangents(rows, deck)
    velocity, velocity_note = _initial_velocity(rows, dim, deck.dt) if steps[0] == 0 else (None, "")
    yield Recording(
        num_frames=len(steps),
        particle_type=np.full(len(ids), int(ParticleType.SAND), dtype=np.int64),
        read=read,
        dim=dim,
        material=material,
        material_features=MATERIAL_FEATURES[:1] if material.shape[1] else (),
        initial_velocity=velocity,
        mass=rows["mass"] if "mass" in (rows.dtype.names or ()) else None,
        dtype="float64",
        stated=stated,
        notes=(*notes, *filter(None, (material_note, velocity_note))),
    )


def _tangents(rows: NDArray[Any], deck: Deck) -> tuple[NDArray[np.float32], str]:
    """Return tan φ of every particle by its material [N, 1], or [N, 0] and why.

    Raises:
        InputError: a material that the deck lacks.
    """
    none = without_material(len(rows))
    angles = {number: material.friction_angle_deg for number, material in deck.materials.items()}
    if len(angles) < 2:
        numbers = np.full(len(rows), next(iter(angles), 0))
    elif "material_id" in (rows.dtype.names or ()):
        numbers = rows["material_id"]
    else:
        return none, f"the deck has {len(angles)} materials and the files no material_id, so none is taken over"
    used = np.unique(numbers).tolist() if angles else []
    lacking = [number for number in used if number not in angles]
    if lacking:
        raise InputError(
            f"its particles are of material_id {lacking[0]}, which {deck.path} lacks; it may be another run's deck: "
            "name the right one, deck=…"
        )
    without = [number for number in used if angles[number] is None]
    if not used or without:
        kind = f"material {without[0]}, {deck.materials[without[0]].kind or 'of no type'}," if without else ""
        return none, f"{kind} has no angle of friction, so no material values are taken over" if without else ""
    table = {number: np.tan(np.radians(angles[number] or 0.0)) for number in used}
    return np.array([[table[number]] for number in numbers.tolist()], dtype=np.float32), ""


def _initial_velocity(rows: NDArray[Any], dim: int, dt: float | None) -> tuple[NDArray[np.float64] | None, str]:
    """Return the velocities of file 0 [N, D] [m/s], None if it does not say, and a sentence where they are told.

    The displacement of the one solver step before the file is what the particles did. It says nothing where they were
    held by constraints, which set the velocity and not the place, or where a run was resumed, with no displacement or
    with all that was there before: then the columns of velocities, with which the solver goes on, are right.

    Args:
        rows: of file 0.
        dim: D.
        dt: solver step [s].
    """
    moved = vector(rows, "displacement", dim) / dt if dt is not None and has_vector(rows, "displacement") else None
    columns = vector(rows, "velocity", dim) if has_vector(rows, "velocity") else None
    if columns is None or not columns.any():
        return moved, ""
    if moved is not None and np.linalg.norm(moved - columns) <= CONTRADICTION * np.linalg.norm(columns):
        return moved, ""
    return columns, "initial velocities are velocity_* of the first file: it is of a run that was held or resumed"


def _frame(files: tuple[Path, ...], ids: NDArray[np.int64], dim: int) -> NDArray[np.float64]:
    rows = read_table(files)
    place = np.searchsorted(rows["id"], ids)
    there = place < len(rows)
    if not there.all() or (rows["id"][np.minimum(place, len(rows) - 1)] != ids).any():
        raise InputError(f"{files[0].name} lacks particles that are there before and after.")
    if dim == 2 and (rows["coord_z"] != 0).any():
        raise InputError(f"{files[0].name} has particles outside the plane z = 0 of a run in two dimensions.")
    return vector(rows[place], "coord", dim)


def _open_source(source: Source) -> ForeignSet | None:
    if (source.path / MANIFEST_NAME).is_file():  # a data set of ours, whatever lies below it
        return None
    folders = find_runs(source.path)
    return open_cb_geo(source.path, folders, deck=source.deck, lost=source.lost) if folders else None


FORMAT = Format("CB-Geo MPM (particles….h5)", (".h5",), _open_source, takes_deck=True)
