"""Which solver runs a scene: the cheapest that was measured to be accurate enough, MPM among them.

What a solver is worth is a table of measured runs (`benchmark.py` writes it): errors against a fine run, and time.
Errors carry over to scenes like those that were measured (`measured_range`), and of others they are unmeasured; times
carry over by the cost of a run.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gns_pl.errors import InputError
from gns_pl.io.tables import read_table
from gns_pl.machine import available_cores
from gns_pl.scene import Scene
from gns_pl.solvers.measured_range import same_kind, unmeasured_reasons
from gns_pl.solvers.reduction import not_plane_reason
from gns_pl.solvers.solver import Solver
from gns_pl.text import command, did_you_mean

WORSE = "worse"
"""The quantity of a tolerance of which nobody says of what it is."""

QUANTITIES = {"front": "front", "map": "map", "height": "mean height", WORSE: "worse of front and map"}
"""What of the end of a run a tolerance may be of (`tolerance_of=`) → the same in words."""

FINE_ERROR = 0.03
"""Of the reference itself, MPM on cells of 1/48 m, against the converged runout (docs/reference.md); none is better."""

FINE_ERRORS = {"front": FINE_ERROR, "map": 0.02, "height": 0.035, WORSE: FINE_ERROR}
"""The same of every quantity: of map and height the root mean square of what the chart's references are unsure of."""

TERRAIN_ERRORS = {"front": 0.02, "map": 0.07, "height": 0.06, WORSE: 0.07}
"""Of the references on terrains, MPM on cells of √(L0 H0)/13: the root mean square of what they are unsure of."""

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
        runout_error: of the final front, 99 % of the mass, relative to the fine run; of a column that of the runout.
        curve_error: of the 99 % runout over time: its mean absolute difference over the final value.
        height_error: of the final mean height, relative.
        profile_error: area between the final profiles over the deposit's.
        seconds: wall time of the run, without compilation and files.
        work: what the time is proportional to (`Solver.cost`).
        particles: of the scene that was run.
        threads: of the machine.
        device: on which it was measured.
        setup: of the scene (`measured_range.setup_text`); empty in tables from before it was written.
        map_error: share of the final volume in the wrong place; NaN in tables from before it was measured.
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
    map_error: float = field(default=math.nan, kw_only=True)

    @property
    def errors(self) -> dict[str, float]:
        """By which the solver is judged: a key of `QUANTITIES` → error, without that of a map that was not measured."""
        errors = {"front": abs(self.runout_error), "map": self.map_error, "height": abs(self.height_error)}
        return with_worse({of: error for of, error in errors.items() if not math.isnan(error)})

    @property
    def error(self) -> float:
        """The worse of front and map."""
        return self.errors[WORSE]


@dataclass(frozen=True)
class Option:
    """A solver for a scene, and what is to be expected of it.

    Attributes:
        solver: the solver.
        errors: expected, a key of `QUANTITIES` each: the largest measured on scenes like this one, at least that of
            `FINE_ERRORS`; none if the solver was not measured on such scenes.
        seconds: expected; None if it was not measured on scenes of this kind.
        reason: why it cannot be trusted with the scene; None if it can.
        unmeasured: how the scene differs from all on which the solver was measured; None where `errors` hold.
        measured_errors: the largest on all scenes of this kind, whether they are like this one or not.
        terrains: names of the scenes on other terrains from which `errors` are known; none of a scene without terrain.
    """

    solver: Solver
    errors: Mapping[str, float]
    seconds: float | None
    reason: str | None
    unmeasured: str | None = None
    measured_errors: Mapping[str, float] = field(default_factory=dict)
    terrains: tuple[str, ...] = ()

    @property
    def error(self) -> float | None:
        """Expected, the worse of front and map; None if none was measured on scenes like this one."""
        return self.errors.get(WORSE)


def kind_of(scene: Scene) -> str:
    """Return "plane" for a scene in plane strain, or of two dimensions, "terrain" for one with ground, else "space"."""
    if scene.dim == 3 and scene.terrain is not None:
        return "terrain"
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
    if all(record.kind != kind for record in records) and kind == "terrain":
        kind = "space"  # a table from before there were such: nothing in it is like a terrain, and MPM runs it
    for solver in solvers:
        reason = solver.unsupported_reason(scene) or solver.out_of_range_reason(scene)
        measured = [record for record in records if record.solver == solver.name and record.kind == kind]
        terrains: tuple[str, ...] = ()
        errors: dict[str, float] = {}
        overall: dict[str, float] = {}
        seconds = unmeasured = None
        if measured and reason is None:
            overall = largest_errors(measured)
            unmeasured = "; ".join(unmeasured_reasons(scene, (record.setup for record in measured))[:2]) or None
            if unmeasured is None:
                alike = [record for record in measured if same_kind(scene, record.setup)]
                errors = largest_errors(alike)
                terrains = tuple(dict.fromkeys(record.scene for record in alike)) if kind == "terrain" else ()
            # Errors do not depend on the number of threads. Times are those of as many as there are, or the next fewer.
            numbers = {record.threads for record in measured}
            threads = max((number for number in numbers if number <= available_cores()), default=min(numbers))
            timed = [record for record in measured if record.threads == threads]
            seconds = solver.cost(scene) * statistics.median(record.seconds / record.work for record in timed)
        if not measured and reason is None:
            reason = "was not measured on scenes of this kind"
        options.append(Option(solver, errors, seconds, reason, unmeasured, overall, terrains))
    return sorted(options, key=lambda option: (option.reason is not None, option.seconds or 0.0))


def largest_errors(records: Sequence[Record]) -> dict[str, float]:
    """Return the largest error of every quantity that was measured, at least that of the reference."""
    every = [record.errors for record in records]
    least_errors = TERRAIN_ERRORS if records[0].kind == "terrain" else FINE_ERRORS
    return {
        of: max(least, *(errors[of] for errors in every if of in errors))
        for of, least in least_errors.items()
        if any(of in errors for errors in every)
    }


def choose(options: Sequence[Option], tolerance: float, of: str = WORSE) -> tuple[Option, str]:
    """Return the cheapest option that meets a tolerance, and why in words.

    Where the scene is like none that was measured, no error is promised: it is the cheapest MPM that met the tolerance
    on the scenes that were.

    Args:
        options: of `estimate`.
        tolerance: largest error, relative.
        of: the quantity it is of, a key of `QUANTITIES`; of the others nothing is promised.

    Raises:
        InputError: a tolerance that is not positive or below every solver's error, a quantity that is none or was not
            measured, or no solver that can be trusted at all.
    """
    check_quantity(of)
    if not tolerance > 0:
        raise InputError(f"tolerance must be positive, as 0.05 for 5 %, not {tolerance}.")
    trusted = [option for option in options if option.reason is None and option.seconds is not None]
    if not trusted:
        raise InputError(
            f"no solver was measured on scenes of this kind; measure it ({command('benchmark')}) and name the table "
            "that this makes (choice.records=), or name a ckpt."
        )
    trusted = [option for option in trusted if of in option.measured_errors]
    if not trusted:
        raise InputError(
            f"tolerance_of={of}: the table of measured runs does not say how far off the {QUANTITIES[of]} was; measure "
            f"again ({command('benchmark')}) or leave tolerance_of= out."
        )
    learned = [option for option in options if option.solver.group in LEARNED]
    prefix = ""
    if learned and all(option.reason is not None for option in learned):
        prefix = "the scene is outside the range of every learned solver, so none of these runs it: "
    candidates = [option for option in trusted if of in option.errors]
    promised = bool(candidates)
    if not promised:
        candidates = [option for option in trusted if option.solver.group == "mpm"] or trusted

    def error(option: Option) -> float:
        return (option.errors if promised else option.measured_errors)[of]

    best = min(candidates, key=error)
    good = [option for option in candidates if error(option) <= tolerance]
    within = f"{100 * tolerance:g} % in the {QUANTITIES[of]}"
    if not good and math.isinf(error(best)):
        raise InputError(f"tolerance={tolerance:g}: every solver failed on a scene that was measured; name a solver=.")
    if not good:
        least = math.ceil(1e3 * error(best) - 1e-9) / 1e3
        where = "on scenes like this one" if promised else "on the scenes that were measured"
        raise InputError(
            f"tolerance={tolerance:g}: every solver errs by more in the {QUANTITIES[of]} {where}; the smallest "
            f"tolerance that can be met is {least:g} (by {best.solver.name})."
        )
    if not promised:
        reason = good[0].unmeasured or f"on scenes like this one nobody measured the {QUANTITIES[of]}"
        return good[0], (
            f"{prefix}the error on this scene is unmeasured ({reason}); it is the cheapest MPM that met "
            f"{within} on the scenes that were measured, and check=true compares it with coarser cells"
        )
    why = f"{prefix}the cheapest of {len(good)} that meet {within}"
    if good[0].terrains:
        names = ", ".join(good[0].terrains)
        why += f", as measured on terrains ({names}) among whose numbers its own lie"
    promise = ("front", "map") if of == WORSE else (of,)
    others = {other: error for other, error in good[0].errors.items() if other not in (*promise, WORSE)}
    return good[0], f"{why}; without a promise: up to {listed(others)}, on scenes like this one" if others else why


def check_quantity(of: str) -> None:
    """Raise an `InputError` unless a tolerance can be of a quantity."""
    if of not in QUANTITIES:
        raise InputError(
            f"tolerance_of must be one of {', '.join(QUANTITIES)}, not {of!r}{did_you_mean(of, QUANTITIES)}."
        )


def with_worse(errors: Mapping[str, float]) -> dict[str, float]:
    """Return errors with the worse of front and map among them, of the front alone where there is none of the map."""
    return {**errors, WORSE: max(error for of, error in errors.items() if of in ("front", "map"))}


def listed(errors: Mapping[str, float]) -> str:
    """Return errors in words, as "12.6 % in the map and 3.5 % in the mean height"; the worse of two is not repeated."""
    parts = [f"{100 * error:.1f} % in the {QUANTITIES[of]}" for of, error in errors.items() if of != WORSE]
    return " and ".join([part for part in (", ".join(parts[:-1]), *parts[-1:]) if part])


def table(options: Sequence[Option], scene: Scene) -> str:
    """Return the options as text, one a line."""
    shown = [of for of in QUANTITIES if of != WORSE]
    columns = "".join(f"{QUANTITIES[of].split()[-1]:>9}" for of in shown)
    lines = [f"{'solver':24} {'runs as':34}{columns} {'time':>9}"]
    for option in options:
        if option.reason is not None or option.seconds is None:
            lines.append(f"{option.solver.name:24} not: {option.reason}")
            continue
        size, dim = option.solver.size(scene), option.solver.reduced(scene).scene.dim
        how = f"{dim}-D" if size is None else f"{dim}-D, {size[0]:,} particles, {size[1]:,} steps"
        errors = "".join(f"{100 * option.errors[of]:7.1f} %" if of in option.errors else f"{'–':>9}" for of in shown)
        errors = errors if option.errors else f"{'unmeasured':>{len(columns)}}"
        lines.append(f"{option.solver.name:24} {how:34}{errors} {option.seconds:7.2f} s")
    reasons = dict.fromkeys(option.unmeasured for option in options if option.unmeasured is not None)
    return "\n".join([*lines, *(f"unmeasured: {reason}" for reason in reasons)])
