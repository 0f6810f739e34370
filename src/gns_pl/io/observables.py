"""The observables of a whole run in a trajectory file: a group of their own, which need not be there."""

from __future__ import annotations

from typing import Any

import numpy as np

from gns_pl.fields import OBSERVED
from gns_pl.io import schema
from gns_pl.trajectory import Observables


def write_observables(file: Any, observables: Observables) -> None:
    """Write observables into an open file that holds the trajectory's positions."""
    for field in OBSERVED:
        array = np.asarray(getattr(observables, field.name), dtype=field.dtype)
        shape = (*array.shape, *(1,) * (len(field.shape) - array.ndim))
        path = f"{schema.OBSERVABLES}/{field.name}"
        stored = file.create_dataset(
            f"{path}/value", data=array.reshape(shape), track_times=False, chunks=shape, fletcher32=True
        )
        if field.unit != "1":
            stored.attrs["unit"] = schema.h5md_unit(field.unit)
        for name, shared in (("step", schema.STEP), ("time", schema.TIME)):
            file[f"{path}/{name}"] = file[shared]  # a hard link, as H5MD has it for elements sampled together
    file[f"{schema.OBSERVABLES}/front"].attrs["percents"] = np.array(observables.percents, dtype=np.float64)
    file[f"{schema.OBSERVABLES}/volume_map"].attrs["cell"] = np.float64(observables.cell)


def observables_in(file: Any, num_frames: int | None = None) -> Observables | None:
    """Return the observables of an open file, which has been checked, or None if it has none.

    Args:
        file: an open `h5py.File`.
        num_frames: of so many frames; of all if None.
    """
    if schema.OBSERVABLES not in file:
        return None
    arrays = {
        field.name: np.asarray(file[f"{schema.OBSERVABLES}/{field.name}/value"][:num_frames]) for field in OBSERVED
    }
    if int(file[schema.BOX].attrs["dimension"]) == 2:
        arrays["volume_map"] = arrays["volume_map"][:, :, 0]
    group = file[schema.OBSERVABLES]
    percents = tuple(float(percent) for percent in group["front"].attrs["percents"])
    return Observables(percents, float(group["volume_map"].attrs["cell"]), **arrays)
