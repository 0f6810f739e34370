"""DeepMind's learning_to_simulate: train.tfrecord, valid.tfrecord, test.tfrecord and metadata.json.

A record is a `SequenceExample`: in its context `particle_type`, N numbers of eight bytes as bytes, and the number of
the trajectory; as lists over time `position`, N × D numbers of four bytes, and in some sets `step_context`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.format import Format
from gns_pl.convert.formats.metadata import read_stated
from gns_pl.convert.formats.source import ForeignSet, Recording, checked_types, reading, without_material
from gns_pl.convert.formats.tfrecord import read_record, record_places, sequence_example
from gns_pl.errors import InputError
from gns_pl.io import SPLITS


def open_learning_to_simulate(path: Path, files: Sequence[Path]) -> ForeignSet:
    """Return a set of .tfrecord files.

    Args:
        path: folder or file, as the user named it.
        files: of it, each a split by its name.

    Raises:
        InputError: a file that cannot be used.
    """
    folder = path if path.is_dir() else path.parent
    names: list[tuple[str, str]] = []
    records: list[tuple[Path, tuple[int, int]]] = []
    for file in files:
        with reading(file):
            places = record_places(file)
        names += [(file.stem if file.stem in SPLITS else "", f"{file.name}, record {k}") for k in range(len(places))]
        records += [(file, place) for place in places]

    stated, of_split = read_stated(folder, {split for split, _ in names})
    dim = None if stated.lower is None else len(stated.lower)

    def opener(number: int) -> AbstractContextManager[Recording]:
        return _open(*records[number], dim)

    return ForeignSet("DeepMind learning_to_simulate", path, tuple(names), opener, stated, of_split)


@contextmanager
def _open(file: Path, place: tuple[int, int], dim: int | None) -> Iterator[Recording]:
    context, lists = sequence_example(read_record(file, place))
    if len(context.get("particle_type", [])) != 1 or not lists.get("position"):
        raise InputError("lacks particle_type or position.")
    types = np.frombuffer(context["particle_type"][0], dtype="<i8")
    frames, number = lists["position"], len(types)
    if not number:
        raise InputError("holds no particles.")
    dim = dim or len(frames[0]) // (4 * number)
    for k, frame in enumerate(frames):
        if len(frame) != 4 * number * dim:
            raise InputError(
                f"frame {k} has {len(frame)} bytes, not {4 * number * dim} as {number} particles in {dim} dimensions "
                "take; the number of particles must not change."
            )

    def read(start: int, stop: int) -> NDArray[Any]:
        return np.stack([np.frombuffer(frame, dtype="<f4").reshape(number, dim) for frame in frames[start:stop]])

    notes = ("step_context, numbers of a whole step, has no place in a trajectory and is left out",)
    yield Recording(
        num_frames=len(frames),
        particle_type=checked_types(types, number),
        read=read,
        dim=dim,
        material=without_material(number),
        notes=notes if "step_context" in lists else (),
    )


FORMAT = Format(
    "DeepMind (.tfrecord)",
    (".tfrecord",),
    lambda source: (
        open_learning_to_simulate(source.path, source.files[".tfrecord"]) if ".tfrecord" in source.files else None
    ),
)
