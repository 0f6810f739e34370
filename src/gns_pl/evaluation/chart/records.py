"""From the chart to the choice: its runs as the table by which `simulate.py tolerance=…` chooses."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from gns_pl.evaluation.chart.tables import RunRow
from gns_pl.io.tables import write_table
from gns_pl.solvers.selection import Record, read_records


def records_of(rows: Iterable[RunRow], setups: Mapping[str, str] | None = None) -> list[Record]:
    """Return one record for every solver, scene, machine and number of threads: the largest errors, the median time.

    Args:
        rows: runs; those that failed count as infinitely wrong.
        setups: hash of scene, frames and reference (`RunRow.judged`) → setup of the scene, for which errors hold.
    """
    groups: dict[tuple[str, str, str, int, str], list[RunRow]] = {}
    for row in rows:
        groups.setdefault((row.name, row.kind, row.scene, row.threads, row.machine), []).append(row)
    return [
        Record(
            solver=name,
            kind=kind,
            scene=scene,
            runout_error=max((row.front_error for row in found), key=abs),
            curve_error=max(row.curve_error for row in found),
            height_error=max((row.height_error for row in found), key=abs),
            profile_error=max(row.profile_error for row in found),
            map_error=max(row.map_error for row in found),
            seconds=statistics.median(map(undisturbed_seconds, found)),
            work=found[0].work,
            particles=found[0].particles,
            threads=threads,
            device=machine,
            setup=(setups or {}).get(found[0].judged, ""),
        )
        for (name, kind, scene, threads, machine), found in groups.items()
    ]


def undisturbed_seconds(row: RunRow) -> float:
    """Return the time of a run [s]: on one thread of a CPU its processor time, which other processes hardly change."""
    return row.cpu_seconds if (row.device, row.threads) == ("cpu", 1) else row.seconds


def write_records(path: Path, records: Sequence[Record]) -> int:
    """Put records into a table, in the place of those of the same solver, scene and number of threads; others stay.

    Args:
        path: the table; made, with its folder, if it is not there.
        records: new ones.

    Returns:
        How many rows the table has now.

    Raises:
        InputError: the file there is another table.
    """
    new = {(each.solver, each.kind, each.scene, each.threads) for each in records}
    there = read_records(path) if path.exists() else []
    kept = [each for each in there if (each.solver, each.kind, each.scene, each.threads) not in new]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(path, Record, [*kept, *records])
    return len(kept) + len(records)
