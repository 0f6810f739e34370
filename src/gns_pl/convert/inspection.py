"""What a source is: its format, shapes, units, statistics, spacing, neighbours, splits, and what it leaves open."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.facts import Findings, find_out
from gns_pl.convert.formats import UNCERTAIN_MATERIAL, ForeignSet
from gns_pl.convert.given import Given
from gns_pl.convert.sample import Sample, listed, take_sample
from gns_pl.data.estimators import neighbour_counts
from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES
from gns_pl.graph.radius import RADIUS
from gns_pl.io import SPLITS

MOST_OPENED = 50
"""Recordings that are opened; of more, evenly spread ones."""
MOST_QUERIES = 300
RADII = (1.5, RADIUS)
"""Where no connectivity radius is stated, neighbours are counted within so many spacings."""


def inspect_source(source: ForeignSet, given: Given) -> list[str]:
    """Return a report, line by line; nothing is written.

    Args:
        source: the source.
        given: what the user says of it.

    Raises:
        InputError: recordings that cannot be read.
    """
    sample = take_sample(source, given.types)
    asked: tuple[str, ...] = ()
    try:
        findings: Findings | None = find_out(source, given)
    except InputError as error:
        findings, asked = None, (str(error),)
    values = findings.values if findings else {}
    lines = [f"{source.path}: {source.kind}"]
    lines += _shapes(source, values.get("material_value"))
    lines += _units(values, sample)
    lines += _motion(values, sample)
    lines += _neighbours(source, values, sample)
    notes = findings.notes if findings else source.stated.notes
    lines += [f"  note: {note}" for note in notes]
    asked = findings.asks if findings else asked
    lines += [f"  missing: {ask}" for ask in asked] or ["  nothing is missing"]
    return lines


def _shapes(source: ForeignSet, material_value: str | None) -> list[str]:
    splits = Counter(split or "no split" for split, _ in source.names)
    order = [*SPLITS, "no split"]
    counted = ", ".join(f"{splits[split]} {split}" for split in order if splits[split])
    chosen = np.unique(np.linspace(0, len(source.names) - 1, MOST_OPENED).round().astype(int))
    frames, particles, types, features, dtypes, dims = [], [], Counter[int](), set(), set(), set()
    notes: list[str] = []
    stated: dict[str, set[Any]] = {name: set() for name in ("box", "gravity", "time step")}
    for number in chosen.tolist():
        with source.recording(number) as recording:
            own = recording.stated or source.stated
            stated["box"].add((own.lower, own.upper))
            stated["gravity"].add(own.gravity)
            stated["time step"].add(own.dt)
            frames.append(recording.num_frames)
            particles.append(recording.num_particles)
            dims.add(recording.dim)
            dtypes.add(recording.dtype)
            features.add(recording.material_features)
            types.update(recording.particle_type.tolist())
            notes += [note for note in recording.notes if note not in notes]
    several = [name for name, values in stated.items() if len(values) > 1]
    if several and not any(note.startswith("trajectories differ") for note in source.stated.notes):
        notes.append(f"trajectories differ in {', '.join(several)}; what is shown here is that of the first")
    meaning = "of unknown meaning" if material_value is None else f"{MATERIAL_FEATURES[0]} by {material_value}"
    meaning = "left out" if material_value == "none" else meaning
    named = sorted({name for columns in features for name in columns})
    named = [f"{name} ({meaning})" if name == UNCERTAIN_MATERIAL else name for name in named]
    kinds = ", ".join(f"{kind} ({count:,} particles)" for kind, count in sorted(types.items()))
    looked = "" if len(chosen) == len(source.names) else f" (of the {len(chosen)} looked at)"
    return [
        f"  trajectories: {len(source.names)} ({counted})",
        f"  shapes{looked}: T = {_range(frames)} frames, N = {_range(particles)} particles, D = {_range(sorted(dims))}",
        f"  positions: {', '.join(sorted(dtypes))}"
        + ("" if dtypes == {"float32"} else "; stored here as float32, so they are rounded"),
        f"  particle types: {kinds}",
        f"  material features: {', '.join(named) or 'none'}",
        *(f"  note: {note}" for note in notes),
    ]


def _units(values: Mapping[str, Any], sample: Sample) -> list[str]:
    scale, axis = values.get("scale"), values.get("axis")
    seen = f"{listed(sample.lower, sample.extent)} to {listed(sample.upper, sample.extent)}"
    lower, upper = values.get("lower"), values.get("upper")
    box = "unknown" if lower is None or upper is None else f"{[float(x) for x in lower]} to {[float(x) for x in upper]}"
    return [
        f"  unit of length: {'unknown' if scale is None else f'{scale:g} m'}",
        f"  time between frames: {_known(values.get('dt'), 's')}",
        f"  gravity: {_known(values.get('gravity'), 'm/s²')}, along axis {'unknown' if axis is None else axis}",
        f"  box: {box}; particles between {seen}",
        f"  spacing: {_known(values.get('spacing'), 'length units')}",
    ]


def _motion(values: Mapping[str, Any], sample: Sample) -> list[str]:
    if not sample.windows:
        return ["  motion: too few frames for velocities"]
    step = np.concatenate([np.diff(window, axis=0).reshape(-1, sample.dim) for window in sample.windows])
    second = np.concatenate([np.diff(window, n=2, axis=0).reshape(-1, sample.dim) for window in sample.windows])
    return [
        f"  displacement a frame (sample): mean {_numbers(step.mean(axis=0))}, std {_numbers(step.std(axis=0))}",
        f"  its change a frame (sample): mean {_numbers(second.mean(axis=0))}, std {_numbers(second.std(axis=0))}",
    ]


def _neighbours(source: ForeignSet, values: Mapping[str, Any], sample: Sample) -> list[str]:
    spacing, stated = values.get("spacing"), source.stated.radius
    if spacing is None and stated is None:
        return []
    radii = [stated] if stated is not None else [factor * (spacing or 1.0) for factor in RADII]
    counts: list[NDArray[np.int64]] = []
    for start in sample.starts:
        queries = np.unique(np.linspace(0, len(start) - 1, MOST_QUERIES).round().astype(int))
        counts.append(neighbour_counts(start, np.array(radii), queries))
    whole = np.concatenate(counts)
    return [
        f"  neighbours within {radius:.4g} ({'stated' if stated is not None else 'no radius is stated'}): "
        f"{whole[:, place].mean():.1f} in the mean, {whole[:, place].max()} at most"
        for place, radius in enumerate(radii)
    ]


def _range(values: Sequence[int]) -> str:
    return str(min(values)) if min(values) == max(values) else f"{min(values)} to {max(values)}"


def _known(value: float | None, unit: str) -> str:
    return "unknown" if value is None else f"{value:g} {unit}"


def _numbers(values: Any) -> str:
    return "[" + ", ".join(f"{float(value):.4g}" for value in values) + "]"
