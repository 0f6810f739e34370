"""Throughput: many scenes at once, as each solver does that best on the device at hand.

A learned simulator steps all scenes of a batch as one graph (`Solver.run_many`). The material point method runs scenes
side by side, one a core, or all in one launch on a GPU. All frames of all scenes are in host memory at the end.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence

from gns_pl.evaluation.chart.converged import Converged
from gns_pl.evaluation.chart.speed import judged_together
from gns_pl.evaluation.chart.tables import BatchRow, Environment, Table
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.solver import Solver


def can_batch(entry: Solver) -> bool:
    """Return whether a solver is measured in batches: learned simulators alone, and MPM where it takes slices."""
    return isinstance(entry, LearnedSolver) or (isinstance(entry, MPMSolver) and entry.selectable)


def measure_batches(
    entries: Sequence[Solver],
    scenes: Sequence[Converged],
    table: Table[BatchRow],
    places: Mapping[str, Environment],
    *,
    sizes: Sequence[int],
    turns: int,
    say: Callable[[str], None] = print,
) -> None:
    """Time batches of every size, as far as the table does not have them.

    Args:
        entries: those that `can_batch`.
        scenes: taken in rotation, each from another placement.
        table: filled.
        places: device → where this process measures with it.
        sizes: numbers of scenes at once.
        turns: timed; one before them warms up.
        say: told every row.
    """
    judged = judged_together(scenes)
    for size in sizes:
        batch = [scenes[number % len(scenes)].flat for number in range(size)]
        seeds = [number // len(scenes) for number in range(size)]
        missing = [entry for entry in entries if _found(table, entry, judged, size, places[entry.device]) is None]
        times: dict[str, list[float]] = {entry.name: [] for entry in missing}
        for turn in range(turns + 1 if missing else 0):
            for entry in missing:
                began = time.perf_counter()
                entry.run_many(batch, interval=scenes[0].interval, seed=seeds, monitor=False)
                if turn:
                    times[entry.name].append(time.perf_counter() - began)
        for entry in missing:
            place, seconds = places[entry.device], statistics.median(times[entry.name])
            how = "one graph" if entry.group == "learned" else "one launch" if entry.device == "cuda" else "one a core"
            row = BatchRow(
                name=entry.name, group=entry.group, identity=entry.identity(), judged=judged, batch=size,
                machine=place.machine, device=place.device, threads=place.threads, how=how, seconds=seconds,
                scenes_per_second=size / seconds, turns=turns, versions=place.versions,
            )  # fmt: skip
            table.add(row)
            say(f"{entry.name:28} {size:3} scenes at once: {row.scenes_per_second:.2f} a second")


def _found(table: Table[BatchRow], entry: Solver, judged: str, size: int, place: Environment) -> BatchRow | None:
    return table.find(
        name=entry.name, identity=entry.identity(), judged=judged, batch=size, machine=place.machine,
        device=place.device, threads=place.threads,
    )  # fmt: skip
