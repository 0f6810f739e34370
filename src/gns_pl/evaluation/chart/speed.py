"""Measuring: settings in turns, warm, one process, a number of threads that is known.

In the time of a run are: placing the particles, neighbour search, network, integration, the grid, and the copies that
bring every frame to this process's memory. Not in it are compilation, reading a checkpoint and writing a file; what the
first run took longer and what writing takes stands beside it.
"""

from __future__ import annotations

import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path

import torch

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.converged import Converged
from gns_pl.evaluation.chart.entries import scene_of
from gns_pl.evaluation.chart.tables import Environment, RatioRow, RunRow, Table
from gns_pl.io import write_trajectory
from gns_pl.machine import available_cores, machine_name
from gns_pl.solvers.selection import kind_of
from gns_pl.solvers.solver import Solver, hashed
from gns_pl.trajectory import Trajectory

SPIN = 0.1
"""Time that idle threads of numerical libraries go on waiting busily, and are in the way of what is timed [s]."""

PACKAGES = ("gns_pl", "torch", "numba", "numpy")


@cache
def _session() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def place_of(device: str, threads: int) -> Environment:
    """Return where this process measures.

    Args:
        device: "cpu" or "cuda".
        threads: that a run may use.
    """
    machine = machine_name()
    if device == "cuda":
        machine = f"{torch.cuda.get_device_name()}, {machine}" if torch.cuda.is_available() else f"CUDA, {machine}"
    versions = " ".join(f"{name} {version(name)}" for name in PACKAGES)
    return Environment(machine, device, threads, f"python {platform.python_version()} {versions}", _session())


@contextmanager
def on_threads(number: int) -> Iterator[int]:
    """Keep this process to a number of cores, and its libraries to as many threads, as long as it lasts; give it back.

    Raises:
        InputError: more than there are.
    """
    import numba

    machine_name()  # says how many cores there are, and is asked but once: before they are fewer
    most = min(available_cores(), int(numba.config.NUMBA_NUM_THREADS))
    if not 1 <= number <= most:
        raise InputError(f"threads must lie between 1 and {most} here, not {number}.")
    before, held = torch.get_num_threads(), numba.get_num_threads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    try:
        if cores:
            os.sched_setaffinity(0, sorted(cores)[:number])
        torch.set_num_threads(number)
        numba.set_num_threads(number)
        yield number
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
        torch.set_num_threads(before)
        numba.set_num_threads(held)


def timed_run(entry: Solver, judged: Converged, seed: int) -> tuple[Trajectory | None, float, float]:
    """Return what a setting makes of a scene, None if it fails, wall time, and this process's processor time [s]."""
    time.sleep(SPIN)
    began, busy = time.perf_counter(), time.process_time()
    try:
        made: Trajectory | None = entry.run(scene_of(entry, judged), interval=judged.interval, seed=seed)
    except InputError:  # a run that became unstable says so; what cannot run at all was refused before
        made = None
    return made, time.perf_counter() - began, time.process_time() - busy


def measure_runs(
    entries: Sequence[Solver],
    scenes: Sequence[Converged],
    table: Table[RunRow],
    places: Mapping[str, Environment],
    *,
    placements: int,
    left_out: Mapping[str, Mapping[str, str]],
    say: Callable[[str], None] = print,
) -> None:
    """Run every setting on every scene from every placement, in turns, as far as the table does not have it.

    Each is run once untimed first. Rows are on the disk as soon as they are known.

    Args:
        entries: settings.
        scenes: with what they should give.
        table: filled.
        places: device → where this process measures with it.
        placements: runs of each setting and scene.
        left_out: name of a setting → scene that it cannot run → why.
        say: told every row.
    """
    missing = {
        (judged.identity, seed, entry.name)
        for judged in scenes
        for seed in range(placements)
        for entry in entries
        if judged.scene.name not in left_out.get(entry.name, {})
        and not _is_there(table, entry, judged, seed, places[entry.device])
    }
    number = 0
    for judged in scenes:
        ours = [each for each in entries if any((judged.identity, n, each.name) in missing for n in range(placements))]
        first = {}
        for entry in ours:
            made, seconds, _ = timed_run(entry, judged, 0)
            first[entry.name] = seconds, _file_seconds(made, table.path.parent)
        for seed in range(placements):
            for entry in ours:
                if (judged.identity, seed, entry.name) not in missing:
                    continue
                row = _measured(entry, judged, seed, places[entry.device], *first[entry.name])
                table.add(row)
                number += 1
                off = f"front {100 * row.front_error:+6.1f} %, map {100 * row.map_error:5.1f} %, {row.seconds:.3f} s"
                say(f"[{number}/{len(missing)}] {judged.scene.name} {entry.name:28} placement {seed}: {off}")


def _measured(
    entry: Solver, judged: Converged, seed: int, place: Environment, first_seconds: float, file_seconds: float
) -> RunRow:
    made, seconds, cpu_seconds = timed_run(entry, judged, seed)
    scene = scene_of(entry, judged)
    particles, steps = entry.size(scene) or (0, 0)
    return RunRow(
        name=entry.name, group=entry.group, identity=entry.identity(), kind=kind_of(judged.scene),
        scene=judged.scene.name, judged=judged.identity, placement=seed, machine=place.machine, device=place.device,
        threads=place.threads, dim=entry.reduced(scene).scene.dim, dtype=entry.dtype, particles=particles,
        steps=steps, work=entry.cost(scene), seconds=seconds, cpu_seconds=cpu_seconds, first_seconds=first_seconds,
        file_seconds=file_seconds, versions=place.versions, session=place.session, **judged.errors(made),
    )  # fmt: skip


def _is_there(table: Table[RunRow], entry: Solver, judged: Converged, seed: int, place: Environment) -> bool:
    key = {
        "name": entry.name, "identity": entry.identity(), "scene": judged.scene.name, "judged": judged.identity,
        "placement": seed, "machine": place.machine, "device": place.device, "threads": place.threads,
    }  # fmt: skip
    return table.find(**key) is not None


def _file_seconds(made: Trajectory | None, folder: Path) -> float:
    if made is None:
        return float("nan")
    with tempfile.TemporaryDirectory(dir=folder, prefix=".file-") as temporary:
        began = time.perf_counter()
        write_trajectory(Path(temporary) / "frames.h5", made)
        return time.perf_counter() - began


def measure_ratios(
    pairs: Sequence[tuple[Solver, Solver]],
    scenes: Sequence[Converged],
    left_out: Mapping[str, Mapping[str, str]],
    table: Table[RatioRow],
    places: Mapping[str, Environment],
    *,
    turns: int,
    say: Callable[[str], None] = print,
) -> None:
    """Time pairs of settings in turns, one after the other over all scenes, as far as the table does not have them.

    Args:
        pairs: a learned setting and a solver's.
        scenes: of a turn, those which the learned setting can run.
        left_out: as of `measure_runs`.
        table: filled.
        places: as of `measure_runs`.
        turns: timed; one before them warms up.
        say: told every row.
    """
    for own, other in pairs:
        place = places[own.device]
        ran = [each for each in scenes if each.scene.name not in left_out.get(own.name, {})]
        judged = judged_together(ran)
        key = {
            "name": own.name, "identity": own.identity(), "other": other.name, "other_identity": other.identity(),
            "judged": judged, "machine": place.machine, "threads": place.threads,
        }  # fmt: skip
        if table.find(**key) is not None:
            continue
        times: list[tuple[float, float]] = []
        for turn in range(turns + 1):
            times.append(tuple(sum(timed_run(each, scene, turn)[1] for scene in ran) for each in (own, other)))  # type: ignore[arg-type]
        kept = times[1:]
        row = RatioRow(
            **key,  # type: ignore[arg-type]
            seconds=statistics.median(each[0] for each in kept) / len(ran),
            other_seconds=statistics.median(each[1] for each in kept) / len(ran),
            ratio=statistics.median(each[1] / each[0] for each in kept),
            turns=turns,
        )
        table.add(row)
        say(f"{own.name} and {other.name} in turns: {row.seconds:.3f} and {row.other_seconds:.3f} s, {row.ratio:.2f}")


def judged_together(scenes: Sequence[Converged]) -> str:
    """Return a hash of scenes that were timed together."""
    return hashed([each.identity for each in scenes])
