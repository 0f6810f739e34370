"""What a foreign set leaves open, worked out from its motion, taken from the user, or asked for in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gns_pl.convert.formats import ForeignSet, Stated
from gns_pl.convert.formats.ours import KIND as OURS
from gns_pl.convert.given import Given, axis_number
from gns_pl.convert.material_value import material_question, stated_meaning
from gns_pl.convert.sample import Sample, box_findings, listed, stated_or_seen_spacing, take_sample
from gns_pl.data.estimators import measure_gravity
from gns_pl.errors import InputError
from gns_pl.scene.origin import COARSE, far_origin, without_origin

EARTH = 9.81
"""Gravity that tells metres from other units [m/s²]."""
METRES = 0.03
"""Free fall within this share of it is in metres and seconds."""
AXES = {2: ("x", "z"), 3: ("x", "y", "z")}


@dataclass(frozen=True)
class Facts:
    """All that is needed to bring a source into SI units, gravity along the last axis.

    Attributes:
        dt: time between frames [s].
        scale: metres in the source's unit.
        axes: axis of the source that becomes each of ours; cyclic, so that nothing is mirrored.
        lower: lower corner of the box, ours [D] [m].
        upper: upper corner of the box, ours [D] [m].
        gravity: acceleration, ours [D] [m/s²].
        spacing: of neighbouring particles [m].
        types: particle types of the source → ours.
        notes: what was worked out and how, sentences.
        origin: what is taken off coordinates that are far from zero, ours [D] [m]; box and positions are less it.
        given: names of what the user said, which then holds for every recording.
        material_value: as `Given`; None where no trajectory that was looked at needs it.
    """

    dt: float
    scale: float
    axes: tuple[int, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    gravity: tuple[float, ...]
    spacing: float
    types: Mapping[int, int]
    notes: tuple[str, ...]
    origin: tuple[float, ...]
    given: tuple[str, ...] = ()
    material_value: str | None = None

    @property
    def dim(self) -> int:
        """D."""
        return len(self.axes)

    def of(self, stated: Stated | None) -> Facts:
        """Return the facts of one recording: what it states of itself, unless the user said otherwise.

        Args:
            stated: by the recording alone, in the source's units and axes; None for nothing.

        Raises:
            InputError: a box or a gravity of other dimensions.
        """
        if stated is None:
            return self
        changes: dict[str, Any] = {}
        for name in ("lower", "upper", "gravity"):
            value = getattr(stated, name)
            if value is None or name in self.given:
                continue
            if len(value) != self.dim:
                raise InputError(f"has a {name} of {len(value)} components in {self.dim} dimensions.")
            changes[name] = tuple(value[axis] * self.scale for axis in self.axes)
        if stated.dt is not None and "dt" not in self.given:
            changes["dt"] = float(stated.dt)
        if stated.spacing is not None and "spacing" not in self.given:
            changes["spacing"] = float(stated.spacing * self.scale)
        if "lower" in changes or "upper" in changes:
            lower, upper = (tuple(np.add(corner, self.origin).tolist()) for corner in (self.lower, self.upper))
            changes |= near_box(changes.get("lower", lower), changes.get("upper", upper))
        return replace(self, **changes)

    def origin_on_map(self, earlier: tuple[float, ...]) -> tuple[float, ...]:
        """Return the origin of a scene, what earlier conversions and this one take off [D] [m].

        Args:
            earlier: what the source says was taken off before, in its units and axes [D]; empty for nothing.

        Raises:
            InputError: an earlier origin of other dimensions.
        """
        if earlier and len(earlier) != self.dim:
            raise InputError(f"has an origin of {len(earlier)} components in {self.dim} dimensions.")
        before = earlier or (0.0,) * self.dim
        return tuple(zero + before[axis] * self.scale for zero, axis in zip(self.origin, self.axes, strict=True))


@dataclass(frozen=True)
class Findings:
    """What could be found out.

    Attributes:
        facts: all of it; None while something is asked for.
        asks: what is missing, sentences with the arguments to give.
        values: name → what is known of the facts, for a report.
        notes: what was worked out and how.
    """

    facts: Facts | None
    asks: tuple[str, ...]
    values: Mapping[str, Any]
    notes: tuple[str, ...]


def work_out(source: ForeignSet, given: Given) -> Facts:
    """Return all facts of a source.

    Raises:
        InputError: something is neither stated, nor seen in the motion, nor given; the sentence says what to add.
    """
    findings = find_out(source, given)
    if findings.facts is None:
        raise InputError(f"{source.path}: {'; '.join(findings.asks)}.")
    return findings.facts


def find_out(source: ForeignSet, given: Given) -> Findings:
    """Return what is stated, given, or seen in a sample of the motion, and what has to be asked for.

    Raises:
        InputError: recordings that cannot be read, periodic axes, or values that contradict each other.
    """
    stated, sample = source.stated, take_sample(source, given.types)
    if any(stated.periodic):
        raise InputError(f"{source.path}: is periodic along an axis, and gns_pl knows walls only.")
    dim, asks, notes = sample.dim, [], list(stated.notes)
    dt = given.dt or stated.dt
    if dt is None:
        asks.append("the time between frames is not stated: give dt=0.0025, in seconds")
    axis, magnitude = _gravity(source, given, sample, dt, notes)
    scale = _scale(source, given, magnitude, asks, notes)
    if axis is None and dt is not None:
        asks.append(
            "the direction of gravity is not stated and cannot be seen, since nothing falls freely: give gravity_axis="
            f"{AXES[dim][-1]} gravity=9.81 scale=1"
        )
    lower, upper = given.lower or stated.lower, given.upper or stated.upper
    if lower is None or upper is None:
        seen = (listed(sample.lower, sample.extent), listed(sample.upper, sample.extent))
        asks.append(f"the box is not stated; the particles lie between {seen[0]} and {seen[1]}: give lower=… upper=…")
    elif len(lower) != dim or len(upper) != dim or any(a >= b for a, b in zip(lower, upper, strict=True)):
        raise InputError(f"{source.path}: a box from {list(lower)} to {list(upper)} does not fit {dim} dimensions.")
    asks += [question for name, question in stated.questions.items() if getattr(given, name) is None]
    material_value = given.material_value or stated_meaning(stated.metadata)
    if sample.material is not None and material_value is None:
        asks.append(material_question(*sample.material))
    spacing = given.spacing or stated_or_seen_spacing(source, sample, asks)
    apart = spacing or stated.spacing
    rounding = sample.rounding(given.for_all)
    if apart is not None and rounding > COARSE * apart:
        raise InputError(
            f"{source.path}: coordinates up to {sample.largest:.6g} are rounded to {rounding:.2g}, as float32 "
            f"is there, for particles {apart:.3g} apart; write them in float64 or less an origin"
        )
    if spacing is not None and lower is not None and upper is not None and len(lower) == len(upper) == dim:
        seen_outside, ask = box_findings(sample, lower, upper, spacing, given.for_all)
        notes += seen_outside
        asks += [ask] if ask else []
    gravity = given.gravity
    if gravity is None and magnitude is not None and scale is not None:
        gravity = magnitude * scale if source.si else float(f"{magnitude * scale:.3g}")
    if axis is not None and gravity is None and scale is not None:
        asks.append("how strong gravity is, is not stated and cannot be seen: give gravity=9.81")
    values = {"dt": dt, "scale": scale, "axis": axis, "gravity": gravity, "lower": lower, "upper": upper,
              "spacing": spacing, "dim": dim, "material_value": material_value}  # fmt: skip
    known = (dt, scale, axis, gravity, lower, upper, spacing)
    if asks or any(value is None for value in known):
        return Findings(None, tuple(asks), values, tuple(notes))
    assert dt and scale and axis is not None and gravity is not None and lower and upper and spacing
    axes = turned_axes(axis, dim)
    if axis != dim - 1:
        names = ", ".join("xyz"[axis] for axis in axes)
        notes.append(f"axes are exchanged in turn so that gravity is along the last: ours are its {names}")
    vector = _vector(source, axes, gravity)
    box = near_box(*(tuple(corner[axis] * scale for axis in axes) for corner in (lower, upper)))
    if any(box["origin"]):
        text = "coordinates are far from zero: the origin {} m is taken off them, and remembered"
        notes.append(text.format(list(box["origin"])))
    facts = Facts(
        dt=float(dt),
        scale=float(scale),
        axes=axes,
        gravity=vector,
        spacing=float(spacing * scale),
        types=given.types,
        notes=tuple(notes),
        given=given.for_all,
        material_value=material_value,
        **box,
    )
    return Findings(facts, (), values, tuple(notes))


def near_box(lower: tuple[float, ...], upper: tuple[float, ...]) -> dict[str, tuple[float, ...]]:
    """Return the fields `lower`, `upper` and `origin` of `Facts` for a box along our axes [D] [m]."""
    origin = far_origin(lower, upper)
    return {"lower": without_origin(lower, origin), "upper": without_origin(upper, origin), "origin": origin}


def turned_axes(axis: int, dim: int) -> tuple[int, ...]:
    """Return the axes of a source in the order of ours, its vertical one last; in turn, so that nothing is mirrored."""
    return tuple((axis + 1 + k) % dim for k in range(dim))


def _vector(source: ForeignSet, axes: tuple[int, ...], gravity: float) -> tuple[float, ...]:
    """Return the acceleration of gravity along our axes [D] [m/s²]: stated inclined, it stays so, of any size."""
    stated = source.stated.gravity
    size = 0.0 if stated is None else math.hypot(*stated)
    if stated is None or not size:
        return (*[0.0] * (len(axes) - 1), 0.0 - gravity)
    factor = 1.0 if math.isclose(size, gravity, rel_tol=1e-6) else gravity / size
    return tuple(stated[axis] * factor for axis in axes)


def _gravity(
    source: ForeignSet, given: Given, sample: Sample, dt: float | None, notes: list[str]
) -> tuple[int | None, float | None]:
    """Return the axis of gravity and its magnitude in the source's units, as stated or as free fall shows it."""
    axis = None if given.gravity_axis is None else axis_number(given.gravity_axis, sample.dim)
    if source.stated.gravity is not None and len(source.stated.gravity) == sample.dim:
        vector = np.array(source.stated.gravity)
        size = float(np.linalg.norm(vector))
        if axis is None:  # ours are along our axes as they are, however steep; without gravity, nothing is to be turned
            axis = sample.dim - 1 if not size or source.kind == OURS else int(np.abs(vector).argmax())
        if vector[axis] > 0 and source.kind != OURS:
            raise InputError(f"{source.path}: gravity points upwards along its axis; mirror the data first.")
        return axis, size
    if given.gravity == 0:
        return sample.dim - 1 if axis is None else axis, None
    if dt is None or not sample.windows:
        return axis, None
    rounding = sample.rounding(given.for_all) / dt**2
    second = [np.diff(window, n=2, axis=0) / dt**2 for window in sample.windows]
    acceleration = np.concatenate([pair[1] for pair in second])
    previous = np.concatenate([pair[0] for pair in second])
    best: tuple[int, int, float, int] | None = None
    for candidate in range(sample.dim) if axis is None else (axis,):
        order = [direction for direction in range(sample.dim) if direction != candidate] + [candidate]
        for sign in (1, -1):
            size, falls = measure_gravity(sign * acceleration[:, order], sign * previous[:, order], rounding)
            if math.isfinite(size) and (best is None or falls.sum() > best[0]):
                best = (int(falls.sum()), candidate, size, sign)
    if best is None:
        return axis, None
    count, axis, size, sign = best
    if sign < 0:
        raise InputError(f"{source.path}: particles fall upwards along axis {axis}; mirror that axis first.")
    share = count / len(acceleration)
    notes.append(f"gravity is {size:.4g} length units/s² along axis {axis}, by the {share:.0%} that fall freely")
    return axis, size


def _scale(
    source: ForeignSet, given: Given, magnitude: float | None, asks: list[str], notes: list[str]
) -> float | None:
    if given.scale is not None or source.si:
        return given.scale or 1.0
    earth = given.gravity or EARTH
    if magnitude is None:
        if given.gravity_axis is not None or given.gravity is not None:
            asks.append("the unit of length is not stated and nothing falls freely: give scale=1, its length in metres")
        return None
    if abs(magnitude / earth - 1) < METRES:
        notes.append("the unit of length is the metre, as free fall shows")
        return 1.0
    asks.append(
        f"free fall is {magnitude:.4g} units/s², so the unit of length is not the metre: give "
        f"scale={earth / magnitude:.4g} if gravity was {earth:g} m/s², or scale=1 to keep the numbers"
    )
    return None
