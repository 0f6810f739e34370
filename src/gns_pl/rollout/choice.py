"""Which way a scene is run: the cheapest that was measured to be accurate enough, the material point method among them.

What a way is worth is a table of measured runs (`benchmark.py` and `benchmarks/reductions.py` write it): errors against
a fine run, and time. Errors carry over to scenes of the same kind, in plane strain or not; times by the work that a run
is.
"""

from __future__ import annotations

import csv
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.generation.pool import available_cores
from gns_pl.rollout.fitted import FittedWay
from gns_pl.rollout.reduction import why_not_plane
from gns_pl.rollout.ways import Way
from gns_pl.scene import Scene

FINE_ERROR = 0.03
"""Of the reference itself, MPM on cells of 1/48 m, against the converged runout (docs/reference.md); none is better."""

RECORDS = Path(__file__).parent / "records.csv"


@dataclass(frozen=True)
class Record:
    """One measured run.

    Attributes:
        way: its name.
        kind: of the scene, `kind_of`.
        scene: its name.
        runout_error: of the final 99 % runout, relative to the fine run.
        curve_error: of the 99 % runout over time: its mean absolute difference over the final value.
        height_error: of the final mean height, relative.
        profile_error: area between the final profiles over the deposit's.
        seconds: wall time of the run, without compilation and files.
        work: what the time is proportional to (`Way.work`).
        particles: of the scene that was run.
        threads: of the machine.
        device: on which it was measured.
    """

    way: str
    kind: str
    scene: str
    runout_error: float
    curve_error: float
    height_error: float
    profile_error: float
    seconds: float
    work: float
    particles: int
    threads: int
    device: str


@dataclass(frozen=True)
class Option:
    """A way for a scene, and what is to be expected of it.

    Attributes:
        way: the way.
        error: largest measured error of the runout on scenes of this kind, at least `FINE_ERROR`; None if none was
            measured.
        seconds: expected; None likewise.
        reason: why it cannot be trusted with the scene; None if it can.
    """

    way: Way
    error: float | None
    seconds: float | None
    reason: str | None


def kind_of(scene: Scene) -> str:
    """Return "plane" for a scene in plane strain, or of two dimensions, else "space"."""
    flat = scene.dim == 2 or None in (why_not_plane(scene, 0), why_not_plane(scene, 1))
    return "plane" if flat else "space"


def read_records(path: Path) -> list[Record]:
    """Return the measured runs of a table.

    Raises:
        InputError: no such file, or another table.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        types = {"int": int, "float": float, "str": str}
        return [Record(**{each.name: types[str(each.type)](row[each.name]) for each in fields(Record)}) for row in rows]
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: is no table of records, as benchmark.py writes ({error}).") from error


def weigh(scene: Scene, ways: Sequence[Way], records: Sequence[Record]) -> list[Option]:
    """Return every way with what is to be expected of it, the cheapest first.

    Args:
        scene: what is to be simulated.
        ways: that there are.
        records: what was measured.
    """
    kind, options = kind_of(scene), []
    for way in ways:
        reason = way.why_not(scene)
        measured = [each for each in records if each.way == way.name and each.kind == kind]
        error = seconds = None
        if measured and reason is None:
            error = max(FINE_ERROR, *(abs(each.runout_error) for each in measured))
            # Errors do not depend on the number of threads. Times are those of as many as there are, or the next fewer.
            numbers = {each.threads for each in measured}
            threads = max((each for each in numbers if each <= available_cores()), default=min(numbers))
            timed = [each for each in measured if each.threads == threads]
            seconds = way.work(scene) * statistics.median(each.seconds / each.work for each in timed)
        if not measured and reason is None:
            reason = "was not measured on scenes of this kind"
        options.append(Option(way, error, seconds, reason))
    return sorted(options, key=lambda each: (each.reason is not None, each.seconds or 0.0))


def choose(options: Sequence[Option], tolerance: float) -> tuple[Option, str]:
    """Return the cheapest option that meets a tolerance, or else the most accurate, and why in words.

    Args:
        options: of `weigh`.
        tolerance: largest error of the final runout, relative.

    Raises:
        InputError: a tolerance that is not positive, or no way that can be trusted at all.
    """
    if not tolerance > 0:
        raise InputError(f"tolerance must be positive, as 0.05 for 5 % of the runout, not {tolerance}.")
    trusted = [each for each in options if each.reason is None and each.error is not None and each.seconds is not None]
    if not trusted:
        raise InputError(
            "no way was measured on scenes of this kind; measure it (python benchmark.py) and name the table that this "
            "makes (choice.records=), or name a ckpt."
        )
    learned = [each for each in options if isinstance(each.way, FittedWay)]
    beyond = ""
    if learned and all(each.reason is not None for each in learned):
        beyond = "the scene is beyond everything learned, so the material point method it is: "
    good = [each for each in trusted if each.error is not None and each.error <= tolerance]
    if good:
        chosen = good[0]
        words = f"the cheapest of {len(good)} that meet {100 * tolerance:g} %"
    else:
        chosen = min(trusted, key=lambda each: each.error or 0.0)
        words = f"none meets {100 * tolerance:g} %, and this is the most accurate"
    return chosen, f"{beyond}{words}"


def named(options: Sequence[Option], name: str) -> Option:
    """Return the option of a way that is asked for, whether it can be trusted or not.

    Raises:
        InputError: there is no such way.
    """
    found = next((each for each in options if each.way.name == name), None)
    if found is None:
        raise InputError(f"way: there is no {name}; there are {', '.join(each.way.name for each in options)}.")
    return found


def table(options: Sequence[Option], scene: Scene) -> str:
    """Return the options as text, one a line."""
    lines = [f"{'way':24} {'runs as':34} {'error':>7} {'time':>9}"]
    for each in options:
        if each.reason is not None or each.error is None or each.seconds is None:
            lines.append(f"{each.way.name:24} not: {each.reason}")
            continue
        particles, steps = each.way.size(scene)
        how = f"{each.way.reduced(scene).scene.dim}-D, {particles:,} particles, {steps:,} steps"
        lines.append(f"{each.way.name:24} {how:34} {100 * each.error:5.1f} % {each.seconds:7.2f} s")
    return "\n".join(lines)
