"""A few frames of a foreign set, from which its units, axes and spacing are worked out."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats import UNCERTAIN_MATERIAL, ForeignSet, Recording, Stated
from gns_pl.data.estimators import interior_spacing, nearest_distance
from gns_pl.data.places import check_inside
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType

SAMPLE = 4
"""Recordings that are looked at."""
WINDOWS = 12
"""Places in each where accelerations are measured."""
OTHER_SPACING = 2.5
"""Ratio of a stated spacing to the seen one from which on it is that of other particles."""
MOST_PARTICLES = 20_000
"""Per window; of more, some evenly spread ones."""


@dataclass(frozen=True)
class RecordingSample:
    """Frames of one recording, in the source's units.

    Attributes:
        stated: what it states of itself.
        start: the moved particles of the first frame [N, D].
        windows: four frames in a row of moved particles, each [4, N, D].
        lower: least coordinates in these, of all particles [D].
        upper: greatest coordinates [D].
    """

    stated: Stated | None
    start: NDArray[np.float64]
    windows: list[NDArray[np.float64]]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    def box(self, given: Collection[str]) -> tuple[tuple[float, ...] | None, ...]:
        """Return the corners of its box [D], None for one that it does not state or that the user gave for all."""
        dim = self.start.shape[1]
        own = [None if name in given else getattr(self.stated, name, None) for name in ("lower", "upper")]
        return tuple(None if corner is None or len(corner) != dim else corner for corner in own)


@dataclass(frozen=True)
class Sample:
    """Frames of some recordings, in the source's units.

    Attributes:
        dim: D.
        seen: of every recording.
        material: least and greatest material value whose meaning is not stated; None without such.
    """

    dim: int
    recordings: list[RecordingSample]
    material: tuple[float, float] | None = None

    @property
    def starts(self) -> list[NDArray[np.float64]]:
        """The moved particles of the first frames, each [N, D]."""
        return [recording.start for recording in self.recordings]

    @property
    def windows(self) -> list[NDArray[np.float64]]:
        """Four frames in a row of moved particles, each [4, N, D]."""
        return [window for recording in self.recordings for window in recording.windows]

    @property
    def lower(self) -> NDArray[np.float64]:
        """Least coordinates seen [D]."""
        return _lowest(self.recordings)

    @property
    def upper(self) -> NDArray[np.float64]:
        """Greatest coordinates seen [D]."""
        return _highest(self.recordings)

    @property
    def largest(self) -> float:
        """The largest coordinate, as a magnitude."""
        return float(max(np.abs(self.lower).max(), np.abs(self.upper).max()))

    @property
    def extent(self) -> float:
        """Longest edge of the box around all that was seen."""
        return float((self.upper - self.lower).max())

    def rounding(self, given: Collection[str]) -> float:
        """Return to what coordinates are rounded: float32 where they are, if all are such numbers; else near zero.

        The latter is what is left of float64 when the origin of each box is taken off.

        Args:
            given: of "lower" and "upper", those that the user gave, for all recordings.
        """
        extent, digit = self.largest, float(np.finfo(np.float32).eps)
        if not all((recording == recording.astype(np.float32)).all() for recording in [*self.starts, *self.windows]):
            places = self.by_box(given).values()
            extent = min(
                extent, max(float((_highest(recordings) - _lowest(recordings)).max()) for recordings in places)
            )
        return digit * extent

    def by_box(self, given: Collection[str]) -> dict[tuple[tuple[float, ...] | None, ...], list[RecordingSample]]:
        """Return box (`RecordingSample.box`) → recordings with it."""
        boxes: dict[tuple[tuple[float, ...] | None, ...], list[RecordingSample]] = {}
        for recording in self.recordings:
            boxes.setdefault(recording.box(given), []).append(recording)
        return boxes


def _lowest(recordings: Iterable[RecordingSample]) -> NDArray[np.float64]:
    return np.asarray(np.min([recording.lower for recording in recordings], axis=0))


def _highest(recordings: Iterable[RecordingSample]) -> NDArray[np.float64]:
    return np.asarray(np.max([recording.upper for recording in recordings], axis=0))


def take_sample(source: ForeignSet, types: Mapping[int, int]) -> Sample:
    """Read a few frames of a few recordings.

    Args:
        source: the source.
        types: particle types that are to be changed.

    Raises:
        InputError: recordings that cannot be read, or of different dimensions.
    """
    chosen = np.unique(np.linspace(0, len(source.names) - 1, SAMPLE).round().astype(int))
    recordings: list[RecordingSample] = []
    dims: set[int] = set()
    values: list[float] = []
    for number in chosen.tolist():
        with source.recording(number) as recording:
            dims.add(recording.dim)
            if recording.material_features == (UNCERTAIN_MATERIAL,):
                values += [float(recording.material.min()), float(recording.material.max())]
            moved = np.flatnonzero(recording.moved if not types else _moved(recording, types))
            if not len(moved):
                continue
            tracked = moved[:: max(1, len(moved) // MOST_PARTICLES)]
            start = recording.frames(0, 1)[0, moved].astype(np.float64)
            windows, lowest, highest = [], [], []
            last = max(0, recording.num_frames - 4)
            places = np.unique(np.concatenate([np.arange(3), np.linspace(0, last, WINDOWS)]).round().astype(int))
            for place in places[places <= last].tolist():
                whole = recording.frames(place, place + 4)
                lowest.append(whole.min(axis=(0, 1)).astype(np.float64))
                highest.append(whole.max(axis=(0, 1)).astype(np.float64))
                if len(whole) == 4:
                    windows.append(whole[:, tracked].astype(np.float64))
            recordings.append(
                RecordingSample(recording.stated, start, windows, np.min(lowest, axis=0), np.max(highest, axis=0))
            )
    if len(dims) > 1:
        raise InputError(f"{source.path}: holds trajectories in two and in three dimensions; convert them apart.")
    if not recordings:
        raise InputError(f"{source.path}: all its particles are kinematic, so nothing moves.")
    material = (min(values), max(values)) if values else None
    return Sample(dims.pop(), recordings, material)


def _moved(recording: Recording, types: Mapping[int, int]) -> NDArray[np.bool_]:
    kinds = np.array([types.get(int(kind), int(kind)) for kind in recording.particle_type])
    return np.asarray(kinds != int(ParticleType.KINEMATIC))


def stated_or_seen_spacing(source: ForeignSet, sample: Sample, asks: list[str]) -> float | None:
    """Return the spacing as the source states it, where that fits the particles, or as it is seen; None if neither.

    Args:
        source: the source.
        sample: of it.
        asks: gets the sentence that asks for it.
    """
    if "spacing" in source.stated.questions:
        return None  # asked for already
    stated, measured = source.stated.spacing, seen_spacing(sample)
    ratio = stated / measured if stated is not None and measured is not None and source.kind != "gns_pl" else 1.0
    if not 1 / OTHER_SPACING < ratio < OTHER_SPACING:
        asks.append(f"the stated spacing, {stated:g}, does not fit particles {measured:g} apart: give spacing=…")
        return None
    if stated is None and measured is None:
        asks.append("the spacing of the particles cannot be seen in so few: give spacing=…")
    return stated or measured


def seen_spacing(sample: Sample) -> float | None:
    """Return the edge of the cube that a particle has to itself, or the distance to the next where there are few."""
    spacings = []
    for start in sample.starts:
        if len(start) < 2:
            continue
        queries = np.unique(np.linspace(0, len(start) - 1, 300).round().astype(int))
        nearest = float(np.median(nearest_distance(start, queries)))
        inside = interior_spacing(start, sample.lower, sample.upper, queries, margin=0.0)
        spacings.append(inside if math.isfinite(inside) and inside > 0 else nearest)
    return float(f"{np.median(spacings):.4g}") if spacings and np.median(spacings) > 0 else None


def listed(values: Iterable[float], extent: float) -> list[float]:
    """Return coordinates with as many digits as tell four of the extent of all, however far from zero they are."""
    digits = 3 - math.floor(math.log10(extent)) if extent > 0 else 6
    return [round(float(value), digits) for value in values]


def box_findings(
    sample: Sample, lower: tuple[float, ...], upper: tuple[float, ...], spacing: float, given: Collection[str]
) -> tuple[list[str], str]:
    """Return what is to be noted of particles outside their box, and the question for another one; empty for nothing.

    Args:
        sample: of the source.
        lower: lower corner of the box of recordings that state none of their own [D].
        upper: upper corner of it [D].
        spacing: particles outside by less are not counted.
        given: of "lower" and "upper", those that the user gave, for all recordings.
    """
    notes = []
    try:
        for own, recordings in sample.by_box(given).items():
            frames = [moved for recording in recordings for moved in (recording.start[None], *recording.windows)]
            notes.append(check_inside(frames, own[0] or lower, own[1] or upper, margin=spacing))
    except InputError as error:
        between = f"{listed(sample.lower, sample.extent)} and {listed(sample.upper, sample.extent)}"
        return [], f"{error}; all are between {between}: give lower=… upper=…, or the right scale=…"
    return [note for note in notes if note], ""
