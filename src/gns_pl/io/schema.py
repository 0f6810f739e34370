"""The HDF5 format of a trajectory as data: what stands where, in which type, shape and unit.

The arrays come from `fields.FIELDS`; the groups around them follow H5MD 1.1 (de Buyl, Colberg and Höfling, Comput.
Phys. Commun. 185, 2014), so that H5MD readers find the positions. The table checks files and renders docs/SCHEMA.md:

    python -c 'import gns_pl.io; print(gns_pl.io.render_schema(), end="")' > docs/SCHEMA.md

No file is opened, written or closed here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.fields import FIELDS, MATERIAL, OBSERVED, PARTICLE_TYPE, POSITION

FORMAT_NAME = "gns_pl trajectory"
FORMAT_VERSION = 2
"""Version of the trajectory file that is written; a reader refuses a newer one. Version 1 had no observables."""
H5MD_VERSION = (1, 1)
UNITS_VERSION = (1, 0)

GROUP = "particles/all"
BOX = f"{GROUP}/box"
STEP = f"{GROUP}/position/step"
TIME = f"{GROUP}/position/time"
SCENE = "parameters/scene"
PROVENANCE = "parameters/provenance"
OBSERVABLES = "observables/whole_run"
FEATURES = f"{GROUP}/{MATERIAL.name}@features"

LOCATION: dict[str, str] = {field.name: f"{GROUP}/{field.name}" for field in FIELDS}
"""Field name → path of its data set, under H5MD's own name where it has one."""
LOCATION[POSITION.name] = f"{GROUP}/position/value"
LOCATION[PARTICLE_TYPE.name] = f"{GROUP}/species"


@dataclass(frozen=True)
class Entry:
    """One data set or attribute of a file.

    Attributes:
        path: place in the file; an attribute is written `group-or-data-set@name`.
        shape: letters, or digits for fixed lengths; () is a scalar.
        dtype: NumPy name of the stored type, or "string".
        unit: SI unit; "1" if it has none.
        meaning: one line for the reader of a file.
    """

    path: str
    shape: tuple[str, ...]
    dtype: str
    unit: str
    meaning: str


ENTRIES: tuple[Entry, ...] = (
    Entry("/@format", (), "string", "1", f'"{FORMAT_NAME}"'),
    Entry("/@format_version", (), "int64", "1", "version of this format; a reader refuses a newer one"),
    Entry("h5md@version", ("2",), "int64", "1", "H5MD version the groups follow"),
    Entry("h5md/author@name", (), "string", "1", 'H5MD wants one; "unknown" unless set by hand'),
    Entry("h5md/creator@name", (), "string", "1", "program that wrote the file"),
    Entry("h5md/creator@version", (), "string", "1", "its version"),
    Entry("h5md/modules/units@version", ("2",), "int64", "1", "version of H5MD's units module"),
    Entry("h5md/modules/units@system", (), "string", "1", '"SI"'),
    Entry(f"{BOX}@dimension", (), "int64", "1", "D"),
    Entry(f"{BOX}@boundary", ("D",), "string", "1", '"none" along every axis: walls, nothing periodic'),
    Entry(f"{BOX}/edges", ("D",), "float64", "m", "edge lengths of the box"),
    Entry(f"{BOX}/lower", ("D",), "float64", "m", "lower corner of the box (H5MD has no place for it)"),
    Entry(STEP, (), "int64", "1", "1: every row of position/value is a frame"),
    Entry(TIME, (), "float64", "s", "dt, the time between two frames; frame k is at k · dt"),
    *(Entry(LOCATION[f.name], f.shape, f.dtype, f.unit, f.meaning) for f in FIELDS),
    Entry(FEATURES, ("K",), "string", "1", "names of the K material features"),
    Entry(SCENE, (), "string", "1", "the Scene as JSON, the form scene_from_dict reads"),
    Entry(PROVENANCE, (), "string", "1", "how it was made, as JSON: solver, settings, versions, seed"),
)
"""Everything a file must hold. More is allowed, as in H5MD, and ignored."""

OBSERVABLE_ENTRIES: tuple[Entry, ...] = (
    *(Entry(f"{OBSERVABLES}/{f.name}/value", f.shape, f.dtype, f.unit, f.meaning) for f in OBSERVED),
    Entry(f"{OBSERVABLES}/front@percents", ("Q",), "float64", "1", "shares of the mass, in per cent"),
    Entry(f"{OBSERVABLES}/volume_map@cell", (), "float64", "m", "wanted distance of nodes; the box takes whole ones"),
)
"""What the group of the observables holds, in a file that has it."""


def h5md_unit(unit: str) -> str:
    """Return `unit` in the spelling of H5MD's units module: "m/s" is "m s-1", "m3" is "m+3"."""
    return re.sub(r"([a-z])(\d)", r"\1+\2", re.sub(r"/(\w+)", r" \1-1", unit))


def check_version(file: Any) -> None:
    """Check that an open file is a trajectory of ours, in a version that can be read.

    Args:
        file: an open `h5py.File`.

    Raises:
        InputError: it is not; the sentence leaves naming the file to the caller.
    """
    if file.attrs.get("format") != FORMAT_NAME or "format_version" not in file.attrs:
        raise InputError("is HDF5, but not a trajectory of gns_pl.")
    version = int(file.attrs["format_version"])
    if version > FORMAT_VERSION:
        raise InputError(
            f"is in format version {version}, newer than the {FORMAT_VERSION} this gns_pl reads; update gns_pl."
        )


def check_file(file: Any) -> dict[str, int]:
    """Check an open file against `ENTRIES`, and against `OBSERVABLE_ENTRIES` where it has the group.

    Args:
        file: an open `h5py.File`.

    Returns:
        The sizes that the letters T, N, D, K stand for.

    Raises:
        InputError: something is missing or of another type, shape or unit; the file is named by the caller.
    """
    check_version(file)
    sizes: dict[str, int] = {}
    for entry in ENTRIES:
        _check_entry(file, entry, sizes)
    if OBSERVABLES in file:
        observed = {"T": sizes["T"]}
        for entry in OBSERVABLE_ENTRIES:
            _check_entry(file, entry, observed)
    if sizes["D"] != int(file[BOX].attrs["dimension"]):
        raise InputError(f"holds positions in {sizes['D']} dimensions, but a box in another number of them.")
    for letter in "TN":
        if sizes[letter] == 0:
            raise InputError(f"holds no {'frames' if letter == 'T' else 'particles'}.")
    if not float(file[TIME][()]) > 0:
        raise InputError(f"{TIME} must be positive.")
    return sizes


def _check_entry(file: Any, entry: Entry, sizes: dict[str, int]) -> None:
    owner, _, name = entry.path.partition("@")
    if owner not in file or (name and name not in file[owner].attrs):
        raise InputError(f"lacks {entry.path}.")
    stored: Any = np.asarray(file[owner].attrs[name]) if name else file[owner]
    if not hasattr(stored, "dtype") or not hasattr(stored, "shape"):
        raise InputError(f"{entry.path} must be a data set, not a group.")
    text = entry.dtype == "string"
    fits = stored.dtype.kind in "OSTU" if text else stored.dtype == np.dtype(entry.dtype)
    if not fits:
        raise InputError(f"{entry.path} must be of type {entry.dtype}, not {stored.dtype}.")
    wanted = f"[{', '.join(entry.shape)}]"
    if len(stored.shape) != len(entry.shape):
        raise InputError(f"{entry.path} must be of shape {wanted}, not {list(stored.shape)}.")
    for letter, length in zip(entry.shape, stored.shape, strict=True):
        if sizes.setdefault(letter, int(letter) if letter.isdigit() else int(length)) != length:
            raise InputError(f"{entry.path} must be of shape {wanted} with {letter} = {sizes[letter]}, not {length}.")
    if not name and entry.unit != "1" and stored.attrs.get("unit") != h5md_unit(entry.unit):
        raise InputError(f"{entry.path} must be in {h5md_unit(entry.unit)}, not in {stored.attrs.get('unit')}.")


def render_schema() -> str:
    """Return docs/SCHEMA.md."""
    rows, observable_rows = _rows(ENTRIES), _rows(OBSERVABLE_ENTRIES)
    h5md = f"[H5MD](https://nongnu.org/h5md/) {'.'.join(map(str, H5MD_VERSION))}"
    return f"""<!-- Made by gns_pl.io.render_schema(); a test keeps it current. -->

# The trajectory file

Format version {FORMAT_VERSION}. One HDF5 file holds one trajectory: positions in frames of one fixed time step,
what does not change with time, the scene and how it was made. The groups follow
{h5md} with fixed step and time.

Shapes: `T` frames, `N` particles, `D` dimensions, `K` material features, `Q` fronts, `X` and `Y` nodes of a map;
`path@name` is an attribute. Units are SI and stand at every data set as the attribute `unit` in H5MD's spelling
(`m s-1`). Gravity acts along the last axis.

| path | shape | type | unit | meaning |
|---|---|---|---|---|
{rows}

What all points of the run do, of which `particles/all` may hold few, stands in a group that data sets have and other
files need not (`metrics.observables`). Beside every `value` are H5MD's `step` and `time`, links to those of the
positions.

| path | shape | type | unit | meaning |
|---|---|---|---|---|
{observable_rows}

- The front of a column is measured from the x- wall, that of another scene from the nearest body's ground plan. The
  grid has round(edge / cell) + 1 nodes, one at least, along each horizontal axis of the box, at its walls the first and
  last; the kinetic energy of frame k belongs to the middle of the step before it.
- Files of version 1 are read; they have no observables.
- Where the scene has an `origin` (D numbers, in m), positions and box are less that: coordinates on the map are
  `position + origin`, to be added in float64. Without one it is zero. Exports for display add it (VTK, ParaView); those
  for training, which are float32, keep it in `metadata.json` under the same name.
- Velocities are not stored: they are the backward differences of the positions, with `initial_velocity` in frame 0.
- Positions are cut into chunks of whole frames and not compressed: a window of a few frames is one short read.
- Every chunk of every array has a checksum (fletcher32), and every number is finite.
- Further groups, data sets and attributes are allowed and ignored.
"""


def _rows(entries: tuple[Entry, ...]) -> str:
    return "\n".join(
        f"| `{e.path}` | {'[' + ', '.join(e.shape) + ']' if e.shape else 'scalar'} | {e.dtype} | "
        f"{'' if e.unit == '1' else e.unit} | {e.meaning} |"
        for e in entries
    )
