"""Which way a scene is run: the cheapest that was measured to be accurate enough, the material point method among them.

What a way is worth is a table of measured runs (`benchmark.py` and `benchmarks/reductions.py` write it): errors against
a fine run, and time. Errors carry over to scenes like those that were measured (`measured_range`), and of others they
are unmeasured; times carry over by the work that a run is.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.io.tables import read_table
from gns_pl.machine import available_cores
from gns_pl.scene import Scene
from gns_pl.solvers.learned import FittedWay
from gns_pl.solvers.measured_range import unmeasured_reasons
from gns_pl.solvers.reduction import why_not_plane
from gns_pl.solvers.solver import MPMWay, Way
from gns_pl.text import command

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
        setup: of the scene (`measured_range.setup_text`); empty in tables from before it was written.
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
    setup: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Option:
    """A way for a scene, and what is to be expected of it.

    Attributes:
        way: the way.
        error: expected of the runout: the largest measured on scenes like this one, at least `FINE_ERROR`; None if none
            was measured on such scenes.
        seconds: expected; None if it was not measured on scenes of this kind.
        reason: why it cannot be trusted with the scene; None if it can.
        unmeasured: how the scene differs from all on which the way was measured; None where `error` holds.
        measured_error: the largest on all scenes of this kind, whether they are like this one or not.
    """

    way: Way
    error: float | None
    seconds: float | None
    reason: str | None
    unmeasured: str | None = None
    measured_error: float | None = None


def kind_of(scene: Scene) -> str:
    """Return "plane" for a scene in plane strain, or of two dimensions, else "space"."""
    flat = scene.dim == 2 or None in (why_not_plane(scene, 0), why_not_plane(scene, 1))
    return "plane" if flat else "space"


def read_records(path: Path) -> list[Record]:
    """Return the measured runs of a table.

    Raises:
        InputError: no such file, or another table.
    """
    return read_table(path, Record, "is no table of records, as benchmark.py writes")


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
        error = seconds = overall = unmeasured = None
        if measured and reason is None:
            overall = max(FINE_ERROR, *(abs(each.runout_error) for each in measured))
            unmeasured = "; ".join(unmeasured_reasons(scene, (each.setup for each in measured))[:2]) or None
            error = overall if unmeasured is None else None
            # Errors do not depend on the number of threads. Times are those of as many as there are, or the next fewer.
            numbers = {each.threads for each in measured}
            threads = max((each for each in numbers if each <= available_cores()), default=min(numbers))
            timed = [each for each in measured if each.threads == threads]
            seconds = way.work(scene) * statistics.median(each.seconds / each.work for each in timed)
        if not measured and reason is None:
            reason = "was not measured on scenes of this kind"
        options.append(Option(way, error, seconds, reason, unmeasured, overall))
    return sorted(options, key=lambda each: (each.reason is not None, each.seconds or 0.0))


def choose(options: Sequence[Option], tolerance: float) -> tuple[Option, str]:
    """Return the cheapest option that meets a tolerance, and why in words.

    Where the scene is like none that was measured, no error is promised: it is the cheapest MPM that met the tolerance
    on the scenes that were.

    Args:
        options: of `weigh`.
        tolerance: largest error of the final runout, relative.

    Raises:
        InputError: a tolerance that is not positive or below every solver's error, or no way that can be trusted at
            all.
    """
    if not tolerance > 0:
        raise InputError(f"tolerance must be positive, as 0.05 for 5 % of the runout, not {tolerance}.")
    trusted = [each for each in options if each.reason is None and each.seconds is not None]
    if not trusted:
        raise InputError(
            f"no way was measured on scenes of this kind; measure it ({command('benchmark')}) and name the table that "
            "this makes (choice.records=), or name a ckpt."
        )
    learned = [each for each in options if isinstance(each.way, FittedWay)]
    beyond = ""
    if learned and all(each.reason is not None for each in learned):
        beyond = "the scene is outside the range of every learned solver, so MPM runs it: "
    candidates = [each for each in trusted if each.error is not None]
    promised = bool(candidates)
    if not promised:
        candidates = [each for each in trusted if isinstance(each.way, MPMWay)] or trusted
    best = min(candidates, key=_measured_error)
    good = [each for each in candidates if _measured_error(each) <= tolerance]
    if not good and math.isinf(_measured_error(best)):
        raise InputError(f"tolerance={tolerance:g}: every solver failed on a scene that was measured; name a solver=.")
    if not good:
        least = math.ceil(1e3 * _measured_error(best) - 1e-9) / 1e3
        where = "on scenes like this one" if promised else "on the scenes that were measured"
        raise InputError(
            f"tolerance={tolerance:g}: every solver errs by more {where}; the smallest tolerance that can be met is "
            f"{least:g} (by {best.way.name})."
        )
    if promised:
        return good[0], f"{beyond}the cheapest of {len(good)} that meet {100 * tolerance:g} %"
    return good[0], (
        f"{beyond}the error on this scene is unmeasured ({good[0].unmeasured}); it is the cheapest MPM that met "
        f"{100 * tolerance:g} % on the scenes that were measured, and check=true compares it with coarser cells"
    )


def _measured_error(option: Option) -> float:
    return math.inf if option.measured_error is None else option.measured_error


def table(options: Sequence[Option], scene: Scene) -> str:
    """Return the options as text, one a line."""
    lines = [f"{'way':24} {'runs as':34} {'error':>10} {'time':>9}"]
    for each in options:
        if each.reason is not None or each.seconds is None:
            lines.append(f"{each.way.name:24} not: {each.reason}")
            continue
        particles, steps = each.way.size(scene)
        how = f"{each.way.reduced(scene).scene.dim}-D, {particles:,} particles, {steps:,} steps"
        error = "unmeasured" if each.error is None else f"{100 * each.error:.1f} %"
        lines.append(f"{each.way.name:24} {how:34} {error:>10} {each.seconds:7.2f} s")
    reasons = dict.fromkeys(each.unmeasured for each in options if each.unmeasured is not None)
    return "\n".join([*lines, *(f"unmeasured: {reason}" for reason in reasons)])
