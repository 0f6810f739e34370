"""CB-Geo MPM: a folder with a file of particles for each saved step, `particles<STEP>.h5`, and the run's JSON deck.

Each file holds one table; with several ranks a step has a file of each, which are joined. Columns are found by name,
rows by the particle's id: they come in the order of storage, and a particle that left the mesh has none. The first
saved step is one solver step after the start; where the particles were then is their place less their displacement.
Velocities in the table are those of the grid, so that differences of the places are used instead.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io.convert.deck import Deck, find_deck, read_deck
from gns_pl.io.convert.groups import whole
from gns_pl.io.convert.source import ForeignSet, Recording, Stated, reading, without_material

FILE = re.compile(r"particles(?:-(?P<rank>\d+)_(?P<size>\d+)-)?(?P<step>\d+)\.h5")
TABLE = "table"
LOST = ("refuse", "drop")


@dataclass(frozen=True)
class Run:
    """The files of a run.

    Attributes:
        folder: where they are.
        steps: number of a saved step → its files, one a rank; rising.
    """

    folder: Path
    steps: Mapping[int, tuple[Path, ...]]


def is_run(folder: Path) -> bool:
    """Return whether a folder holds files of particles."""
    return any(FILE.fullmatch(path.name) for path in folder.iterdir())


def open_cb_geo(path: Path, folders: list[Path], *, deck: Path | None, lost: str) -> ForeignSet:
    """Return the runs of folders, a trajectory each.

    Args:
        path: as the user named it.
        folders: of the runs.
        deck: JSON input of the runs; None looks for one in and over the folder.
        lost: "refuse" runs whose particles become fewer, or "drop" those particles from all frames.

    Raises:
        InputError: files or a deck that cannot be used.
    """
    if lost not in LOST:
        raise InputError(f"lost must be one of {', '.join(LOST)}, not {lost!r}.")
    runs = [_run(folder) for folder in folders]
    found = deck or find_deck(folders[0])
    content = Deck() if found is None else read_deck(found)
    steps = sorted(runs[0].steps)
    stated = _stated(content, steps)
    if found is None:
        note = "no JSON deck was found, so time step, box, gravity and material are open; name it: deck=…"
        stated = replace(stated, notes=(*stated.notes, note))

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(runs[number], content, lost)

    names = tuple(("", run.folder.name) for run in runs)
    return ForeignSet("CB-Geo MPM", path, names, opener, stated)


def _stated(deck: Deck, steps: list[int]) -> Stated:
    dt, notes = None, list(deck.notes)
    if deck.dt is not None and len(steps) > 1:
        dt = (steps[1] - steps[0]) * deck.dt
        notes.append(f"the first frame is {(steps[0] + 1) * deck.dt:g} s after the start of the run")
    return Stated(
        dt=dt,
        lower=deck.lower,
        upper=deck.upper,
        gravity=deck.gravity,
        density=deck.density,
        friction_angle_deg=deck.friction_angle_deg,
        notes=tuple(notes),
    )


def _run(folder: Path) -> Run:
    """Find the files of every step, each with all its ranks.

    Raises:
        InputError: ranks that are missing, or steps that do not follow evenly.
    """
    steps: dict[int, dict[int, Path]] = {}
    sizes: dict[int, set[int]] = {}
    for path in sorted(folder.iterdir()):
        match = FILE.fullmatch(path.name)
        if match:
            rank, size, step = (int(match[key] or default) for key, default in (("rank", 0), ("size", 1), ("step", 0)))
            steps.setdefault(step, {})[rank] = path
            sizes.setdefault(step, set()).add(size)
    for step, ranks in steps.items():
        if len(sizes[step]) != 1 or sorted(ranks) != list(range(next(iter(sizes[step])))):
            raise InputError(f"{folder}: step {step} lacks the files of some ranks, or has those of two runs.")
    order = sorted(steps)
    if len(order) > 2 and len(set(np.diff(order).tolist())) > 1:
        raise InputError(f"{folder}: its steps do not follow evenly; a file is missing, or two runs share the folder.")
    return Run(folder, {step: tuple(steps[step][rank] for rank in sorted(steps[step])) for step in order})


def _table(files: tuple[Path, ...]) -> NDArray[Any]:
    """Return the rows of a step [N] by rising id.

    Raises:
        InputError: no such table, or an id twice.
    """
    parts = []
    for path in files:
        with reading(path), h5py.File(path, "r", locking=False) as file:
            rows = whole(file, TABLE)
            needed = ["id", "coord_x", "coord_y", "coord_z"]
            columns = rows.dtype.names or ()
            missing = [name for name in needed if name not in columns]
            if rows.ndim != 1 or missing:
                raise InputError(f"its table lacks {', '.join(missing) or 'rows'}; it is not one of particles.")
            kept = [name for name in (*needed, *OPTIONAL) if name in columns]
            part = np.empty(len(rows), dtype=[(name, np.int64 if name == "id" else np.float64) for name in kept])
            for name in kept:
                if rows.dtype[name].kind not in ("iu" if name == "id" else "iuf") or rows.dtype[name].shape:
                    raise InputError(f"{name} in its table must hold numbers, not {rows.dtype[name]}.")
                with np.errstate(
                    over="ignore", invalid="ignore"
                ):  # what does not fit is not finite, and refused as that
                    part[name] = rows[name]
            parts.append(part)
    if any(part.dtype != parts[0].dtype for part in parts):
        raise InputError(f"{files[0].name} and the other ranks' files have different columns.")
    joined = np.concatenate(parts)
    joined = joined[np.argsort(joined["id"], kind="stable")]
    if (np.diff(joined["id"]) == 0).any():
        raise InputError(f"{files[0].name}: a particle's id is there twice.")
    return joined


OPTIONAL = ("mass", "displacement_x", "displacement_y", "displacement_z", "volume")


def _position(rows: NDArray[Any], prefix: str, dim: int) -> NDArray[np.float64]:
    return np.stack([rows[f"{prefix}_{axis}"] for axis in "xyz"[:dim]], axis=1)


@contextmanager
def _open(run: Run, deck: Deck, lost: str) -> Iterator[Recording]:
    steps = list(run.steps)
    first, last = _table(run.steps[steps[0]]), _table(run.steps[steps[-1]])
    ids = first["id"]
    if len(last) != len(first) or (last["id"] != ids).any():
        left = len(np.setdiff1d(ids, last["id"]))
        if lost == "refuse":
            raise InputError(
                f"{left} of {len(ids)} particles left the mesh, and a trajectory has the same ones in all frames; with "
                "lost=drop these are left out of all of them."
            )
        ids = np.intersect1d(ids, last["id"])
    rows = first[np.searchsorted(first["id"], ids)]
    flat = bool((first["coord_z"] == 0).all() and (last["coord_z"] == 0).all())
    dim = len(deck.lower) if deck.lower is not None else 2 if flat else 3
    if not len(ids):
        raise InputError("no particle is there from beginning to end.")

    def read(start: int, stop: int) -> NDArray[Any]:
        return np.stack([_frame(run.steps[step], ids, dim) for step in steps[start:stop]])

    velocity = None
    columns = rows.dtype.names or ()
    if steps[0] == 0 and deck.dt is not None and "displacement_x" in columns:
        velocity = _position(rows, "displacement", dim) / deck.dt  # over the one solver step before the first frame
    tangent = deck.friction_angle_deg
    material = without_material(len(ids))
    if tangent is not None:
        material = np.full((len(ids), 1), np.tan(np.radians(tangent)), dtype=np.float32)
    notes = (f"{len(first) - len(ids)} particles that left the mesh are left out",) if len(ids) < len(first) else ()
    yield Recording(
        num_frames=len(steps),
        particle_type=np.full(len(ids), int(ParticleType.SAND), dtype=np.int64),
        read=read,
        dim=dim,
        material=material,
        material_features=("tan_friction_angle",) if tangent is not None else (),
        initial_velocity=velocity,
        mass=rows["mass"] if "mass" in columns else None,
        dtype="float64",
        notes=notes,
    )


def _frame(files: tuple[Path, ...], ids: NDArray[np.int64], dim: int) -> NDArray[np.float64]:
    rows = _table(files)
    place = np.searchsorted(rows["id"], ids)
    there = place < len(rows)
    if not there.all() or (rows["id"][np.minimum(place, len(rows) - 1)] != ids).any():
        raise InputError(f"{files[0].name} lacks particles that are there before and after.")
    if dim == 2 and (rows["coord_z"] != 0).any():
        raise InputError(f"{files[0].name} has particles outside the plane z = 0 of a run in two dimensions.")
    return _position(rows[place], "coord", dim)
