"""Which format a path is in, by what lies there and not by what the user has to know."""

from __future__ import annotations

from pathlib import Path

from gns_pl.convert.formats import (
    arrays,
    cb_geo,
    geoelements,
    lagrangebench,
    learning_to_simulate,
    ours,
    vtk,
)
from gns_pl.convert.formats.format import Format, Source
from gns_pl.convert.formats.source import ForeignSet
from gns_pl.errors import InputError

FORMATS: list[Format] = [
    cb_geo.FORMAT,
    ours.FORMAT,
    vtk.FORMAT,
    learning_to_simulate.FORMAT,
    lagrangebench.FORMAT,
    geoelements.FORMAT,
    arrays.FORMAT,
]
"""All that are read, in the order in which they are asked. geoelements/gns refuses HDF5 of all kinds but its own, and
plain arrays take what is left of .npz, so others of these endings stand before them."""


def open_set(
    source: str | Path, *, trust: bool = False, deck: str | Path | None = None, lost: str = "refuse"
) -> ForeignSet:
    """Return what a path holds, whatever format it is in.

    Args:
        source: file or folder.
        trust: read pickled arrays of geoelements/gns, without running anything that stands in them.
        deck: JSON input of CB-Geo MPM runs, or of a VTK series of one; None looks for those of runs.
        lost: what to do with particles that left CB-Geo's mesh: "refuse" the run, or "drop" them from all frames.

    Raises:
        InputError: nothing there, or nothing that is known; the path is named.
    """
    path = Path(source)
    if not path.exists():
        raise InputError(f"{path}: there is no such file or folder.")
    known = {ending for file_format in FORMATS for ending in file_format.endings}
    looked_at = Source(path, known, trust=trust, deck=None if deck is None else Path(deck), lost=lost)
    for file_format in FORMATS:
        if deck is None or file_format.takes_deck:
            foreign_set = file_format.open(looked_at)
            if foreign_set is not None:
                return foreign_set
    if deck is not None:
        raise InputError(f"{path}: holds no runs of CB-Geo MPM and no VTK series of one, to which deck= belongs.")
    names = ", ".join(file_format.name for file_format in FORMATS)
    raise InputError(f"{path}: holds none of the formats that are known: {names}.")
