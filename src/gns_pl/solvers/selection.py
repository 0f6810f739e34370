"""Which solver runs a scene: the cheapest that was measured to be accurate enough, MPM among them.

What a solver is worth is a table of measured runs (`benchmark.py` writes it): errors against a fine run, and time.
Errors carry over to scenes like those that were measured (`measured_range`), and of others they are unmeasured; times
carry over by the cost of a run.
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
from gns_pl.solvers.measured_range import unmeasured_reasons
from gns_pl.solvers.reduction import not_plane_reason
from gns_pl.solvers.solver import Solver
from gns_pl.text import command

FINE_ERROR = 0.03
"""Of the reference itself, MPM on cells of 1/48 m, against the converged runout (docs/reference.md); none is better."""

LEARNED = ("learned", "corrected", "hybrid")
"""Groups of solvers that learned from data, or a part of which did."""

RECORDS = Path(__file__).parent / "records.csv"


@dataclass(frozen=True)
class Record:
    """One measured run.

    Attributes:
        solver: its name.
        kind: of the scene, `kind_of`.
        scene: its name.
        runout_error: of the final 99 % runout, relative to the fine run.
        curve_error: of the 99 % runout over time: its mean absolute difference over the final value.
        height_error: of the final mean height, relative.
        profile_error: area between the final profiles over the deposit's.
        seconds: wall time of the run, without compilation and files.
        work: what the time is proportional to (`Solver.cost`).
        particles: of the scene that was run.
        threads: of the machine.
        device: on which it was measured.
        setup: of the scene (`measured_range.setup_text`); empty in tables from before it was written.
    """

    solver: str
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
    """A solver for a scene, and what is to be expected of it.

    Attributes:
        solver: the solver.
        error: expected of the runout: the largest measured on scenes like this one, at least `FINE_ERROR`; None if none
            was measured on such scenes.
        seconds: expected; None if it was not measured on scenes of this kind.
        reason: why it cannot be trusted with the scene; None if it can.
        unmeasured: how the scene differs from all on which the solver was measured; None where `error` holds.
        measured_error: the largest on all scenes of this kind, whether they are like this one or not.
    """

    solver: Solver
    error: float | None
    seconds: float | None
    reason: str | None
    unmeasured: str | None = None
    measured_error: float | None = None


def kind_of(scene: Scene) -> str:
    """Return "plane" for a scene in plane strain, or of two dimensions, else "space"."""
    flat = scene.dim == 2 or None in (not_plane_reason(scene, 0), not_plane_reason(scene, 1))
    return "plane" if flat else "space"


def read_records(path: Path) -> list[Record]:
    """Return the measured runs of a table.

    Raises:
        InputError: no such file, or another table.
    """
    return read_table(path, Record, "is no table of records, as benchmark.py writes", renamed={"way": "solver"})


def estimate(scene: Scene, solvers: Sequence[Solver], records: Sequence[Record]) -> list[Option]:
    """Return every solver with what is to be expected of it, the cheapest first.

    Args:
        scene: what is to be simulated.
        solvers: that there are.
        records: what was measured.
    """
    kind, options = kind_of(scene), []
    for solver in solvers:
        reason = solver.unsupported_reason(scene) or solver.out_of_range_reason(scene)
        measured = [record for record in records if record.solver == solver.name and record.kind == kind]
        error = seconds = overall = unmeasured = None
        if measured and reason is None:
            overall = max(FINE_ERROR, *(abs(record.runout_error) for record in measured))
            unmeasured = "; ".join(unmeasured_reasons(scene, (record.setup for record in measured))[:2]) or None
            error = overall if unmeasured is None else None
            # Errors do not depend on the number of threads. Times are those of as many as there are, or the next fewer.
            numbers = {record.threads for record in measured}
            threads = max((number for number in numbers if number <= available_cores()), default=min(numbers))
            timed = [record for record in measured if record.threads == threads]
            seconds = solver.cost(scene) * statistics.median(record.seconds / record.work for record in timed)
        if not measured and reason is None:
            reason = "was not measured on scenes of this kind"
        options.append(Option(solver, error, seconds, reason, unmeasured, overall))
    return sorted(options, key=lambda option: (option.reason is not None, option.seconds or 0.0))


def choose(options: Sequence[Option], tolerance: float) -> tuple[Option, str]:
    """Return the cheapest option that meets a tolerance, and why in words.

    Where the scene is like none that was measured, no error is promised: it is the cheapest MPM that met the tolerance
    on the scenes that were.

    Args:
        options: of `estimate`.
        tolerance: largest error of the final runout, relative.

    Raises:
        InputError: a tolerance that is not positive or below every solver's error, or no solver that can be trusted
            at all.
    """
    if not tolerance > 0:
        raise InputError(f"tolerance must be positive, as 0.05 for 5 % of the runout, not {tolerance}.")
    trusted = [option for option in options if option.reason is None and option.seconds is not None]
    if not trusted:
        raise InputError(
            f"no solver was measured on scenes of this kind; measure it ({command('benchmark')}) and name the table "
            "that this makes (choice.records=), or name a ckpt."
        )
    learned = [option for option in options if option.solver.group in LEARNED]
    prefix = ""
    if learned and all(option.reason is not None for option in learned):
        prefix = "the scene is outside the range of every learned solver, so MPM runs it: "
    candidates = [option for option in trusted if option.error is not None]
    promised = bool(candidates)
    if not promised:
        candidates = [option for option in trusted if option.solver.group == "mpm"] or trusted
    best = min(candidates, key=_measured_error)
    good = [option for option in candidates if _measured_error(option) <= tolerance]
    if not good and math.isinf(_measured_error(best)):
        raise InputError(f"tolerance={tolerance:g}: every solver failed on a scene that was measured; name a solver=.")
    if not good:
        least = math.ceil(1e3 * _measured_error(best) - 1e-9) / 1e3
        where = "on scenes like this one" if promised else "on the scenes that were measured"
        raise InputError(
            f"tolerance={tolerance:g}: every solver errs by more {where}; the smallest tolerance that can be met is "
            f"{least:g} (by {best.solver.name})."
        )
    if promised:
        return good[0], f"{prefix}the cheapest of {len(good)} that meet {100 * tolerance:g} %"
    return good[0], (
        f"{prefix}the error on this scene is unmeasured ({good[0].unmeasured}); it is the cheapest MPM that met "
        f"{100 * tolerance:g} % on the scenes that were measured, and check=true compares it with coarser cells"
    )


def _measured_error(option: Option) -> float:
    return math.inf if option.measured_error is None else option.measured_error


def table(options: Sequence[Option], scene: Scene) -> str:
    """Return the options as text, one a line."""
    lines = [f"{'solver':24} {'runs as':34} {'error':>10} {'time':>9}"]
    for option in options:
        if option.reason is not None or option.seconds is None:
            lines.append(f"{option.solver.name:24} not: {option.reason}")
            continue
        size, dim = option.solver.size(scene), option.solver.reduced(scene).scene.dim
        how = f"{dim}-D" if size is None else f"{dim}-D, {size[0]:,} particles, {size[1]:,} steps"
        error = "unmeasured" if option.error is None else f"{100 * option.error:.1f} %"
        lines.append(f"{option.solver.name:24} {how:34} {error:>10} {option.seconds:7.2f} s")
    reasons = dict.fromkeys(option.unmeasured for option in options if option.unmeasured is not None)
    return "\n".join([*lines, *(f"unmeasured: {reason}" for reason in reasons)])
