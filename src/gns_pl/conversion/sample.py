"""A few frames of a foreign set, from which its units, axes and spacing are worked out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gns_pl.data.probes import interior_spacing, nearest_distance
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io.convert import UNCERTAIN_MATERIAL, ForeignSet, Recording

SAMPLE = 4
"""Recordings that are looked at."""
WINDOWS = 12
"""Places in each where accelerations are measured."""
OTHER_SPACING = 2.5
"""Ratio of a stated spacing to the seen one from which on it is that of other particles."""
MOST_PARTICLES = 20_000
"""Per window; of more, some evenly spread ones."""


@dataclass(frozen=True)
class Sample:
    """Frames of some recordings, in the source's units.

    Attributes:
        dim: D.
        starts: the moved particles of some first frames, each [N, D].
        lower: least coordinates seen [D].
        upper: greatest coordinates seen [D].
        windows: four frames in a row of moved particles, each [4, N, D].
        material: least and greatest material value whose meaning is not stated; None without such.
    """

    dim: int
    starts: list[NDArray[np.float64]]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    windows: list[NDArray[np.float64]]
    material: tuple[float, float] | None = None


def take_sample(found: ForeignSet, types: Mapping[int, int]) -> Sample:
    """Read a few frames of a few recordings.

    Args:
        found: the source.
        types: particle types that are to be changed.

    Raises:
        InputError: recordings that cannot be read, or of different dimensions.
    """
    chosen = np.unique(np.linspace(0, len(found.names) - 1, SAMPLE).round().astype(int))
    starts, windows, dims = [], [], set()
    values: list[float] = []
    lowest: list[NDArray[np.float64]] = []
    highest: list[NDArray[np.float64]] = []
    for number in chosen.tolist():
        with found.recording(number) as recording:
            dims.add(recording.dim)
            if recording.material_features == (UNCERTAIN_MATERIAL,):
                values += [float(recording.material.min()), float(recording.material.max())]
            moved = np.flatnonzero(recording.moved if not types else _moved(recording, types))
            if not len(moved):
                continue
            some = moved[:: max(1, len(moved) // MOST_PARTICLES)]
            starts.append(recording.frames(0, 1)[0, moved].astype(np.float64))
            last = max(0, recording.num_frames - 4)
            places = np.unique(np.concatenate([np.arange(3), np.linspace(0, last, WINDOWS)]).round().astype(int))
            for place in places[places <= last].tolist():
                whole = recording.frames(place, place + 4)
                lowest.append(whole.min(axis=(0, 1)).astype(np.float64))
                highest.append(whole.max(axis=(0, 1)).astype(np.float64))
                if len(whole) == 4:
                    windows.append(whole[:, some].astype(np.float64))
    if len(dims) > 1:
        raise InputError(f"{found.path}: holds trajectories in two and in three dimensions; convert them apart.")
    if not starts:
        raise InputError(f"{found.path}: all its particles are kinematic, so nothing moves.")
    material = (min(values), max(values)) if values else None
    return Sample(dims.pop(), starts, np.min(lowest, axis=0), np.max(highest, axis=0), windows, material)


def _moved(recording: Recording, types: Mapping[int, int]) -> NDArray[np.bool_]:
    kinds = np.array([types.get(int(each), int(each)) for each in recording.particle_type])
    return np.asarray(kinds != int(ParticleType.KINEMATIC))


def stated_or_seen_spacing(found: ForeignSet, sample: Sample, asks: list[str]) -> float | None:
    """Return the spacing as the source states it, where that fits the particles, or as it is seen; None if neither.

    Args:
        found: the source.
        sample: of it.
        asks: gets the sentence that asks for it.
    """
    if "spacing" in found.stated.questions:
        return None  # asked for already
    stated, seen = found.stated.spacing, seen_spacing(sample)
    ratio = stated / seen if stated is not None and seen is not None and found.kind != "gns_pl" else 1.0
    if not 1 / OTHER_SPACING < ratio < OTHER_SPACING:
        asks.append(f"the stated spacing, {stated:g}, does not fit particles {seen:g} apart: give spacing=…")
        return None
    if stated is None and seen is None:
        asks.append("the spacing of the particles cannot be seen in so few: give spacing=…")
    return stated or seen


def seen_spacing(sample: Sample) -> float | None:
    """Return the edge of the cube that a particle has to itself, or the distance to the next where there are few."""
    found = []
    for start in sample.starts:
        if len(start) < 2:
            continue
        queries = np.unique(np.linspace(0, len(start) - 1, 300).round().astype(int))
        nearest = float(np.median(nearest_distance(start, queries)))
        inside = interior_spacing(start, sample.lower, sample.upper, queries, margin=0.0)
        found.append(inside if math.isfinite(inside) and inside > 0 else nearest)
    return float(f"{np.median(found):.4g}") if found and np.median(found) > 0 else None
