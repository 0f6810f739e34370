"""Throughput: many scenes at once, as each solver does that best on the device at hand.

A learned simulator steps all scenes of a batch as one graph (`rollout.unroll`). The material point method runs scenes
side by side, one a core, or all in one launch on a GPU. All frames of all scenes are in host memory at the end.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch

from gns_pl.evaluation.chart.converged import Converged
from gns_pl.evaluation.chart.entries import Entry
from gns_pl.evaluation.chart.rows import BatchRow, Place, Table
from gns_pl.evaluation.chart.speed import judged_together
from gns_pl.mpm import settings as solver
from gns_pl.rollout.engine import Run, unroll
from gns_pl.rollout.stabilise import stabilise
from gns_pl.scene import Scene
from gns_pl.solvers.learned import LearnedWay, start_of
from gns_pl.solvers.solver import MPMWay

Jobs = Sequence[tuple[Scene, int]]
"""Scenes and seeds of their placement."""


def can_batch(entry: Entry) -> bool:
    """Return whether a setting is measured in batches: learned simulators alone, and MPM where it takes slices."""
    return type(entry.way) is LearnedWay or (isinstance(entry.way, MPMWay) and entry.for_choice)


def run_learned(way: LearnedWay, jobs: Jobs) -> int:
    """Step scenes as one graph and return the number of frames that came."""
    stepper = stabilise(way.checkpoint.simulator, **way.stabilise)
    starts = [start_of(way.reduced(scene).scene, way.checkpoint, seed, {}) for scene, seed in jobs]
    runs = [Run(start, way.size(scene)[1]) for start, (scene, _) in zip(starts, jobs, strict=True)]
    frames: list[list[np.ndarray]] = [[each.position[0]] for each in starts]
    with torch.inference_mode():
        for parts in unroll(stepper, runs):
            for number, part in parts.items():
                frames[number].append(part.cpu().numpy())
    return sum(len(each) for each in frames)


def run_solver(way: MPMWay, jobs: Jobs, interval: float, threads: int) -> int:
    """Run scenes side by side and return the number of frames that came."""
    reduced = [way.reduced(scene).scene for scene, _ in jobs]
    if way.device == "cuda":
        # One launch takes one size of cells.
        made, groups = 0, dict[float, tuple[dict[str, Any], list[tuple[Scene, int]]]]()
        for (scene, seed), less in zip(jobs, reduced, strict=True):
            groups.setdefault(way.settings_of(scene)["cell_size"], (way.settings_of(scene), []))[1].append((less, seed))
        for settings, each in groups.values():
            scenes, seeds = zip(*each, strict=True)
            runs = solver.run_batch(scenes, settings, frame_interval=interval, seeds=seeds)
            made += sum(run.num_frames for run in runs)
        return made

    def one(number: int) -> int:
        scene, seed = jobs[number]
        settings = way.settings_of(scene)
        return solver.run_solver(reduced[number], settings, frame_interval=interval, seed=seed).num_frames

    with ThreadPoolExecutor(threads) as pool:  # its kernels let other threads run
        return sum(pool.map(one, range(len(jobs))))


def measure_batches(
    entries: Sequence[Entry],
    scenes: Sequence[Converged],
    table: Table[BatchRow],
    places: Mapping[str, Place],
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
        jobs = [(scenes[number % len(scenes)].flat, number // len(scenes)) for number in range(size)]
        missing = [entry for entry in entries if _found(table, entry, judged, size, places[entry.device]) is None]
        times: dict[str, list[float]] = {entry.name: [] for entry in missing}
        for turn in range(turns + 1 if missing else 0):
            for entry in missing:
                began = time.perf_counter()
                if isinstance(entry.way, LearnedWay):
                    run_learned(entry.way, jobs)
                elif isinstance(entry.way, MPMWay):
                    run_solver(entry.way, jobs, scenes[0].interval, places[entry.device].threads)
                if turn:
                    times[entry.name].append(time.perf_counter() - began)
        for entry in missing:
            place, seconds = places[entry.device], statistics.median(times[entry.name])
            how = "one graph" if entry.group == "learned" else "one launch" if entry.device == "cuda" else "one a core"
            row = BatchRow(
                name=entry.name, group=entry.group, identity=entry.identity, judged=judged, batch=size,
                machine=place.machine, device=place.device, threads=place.threads, how=how, seconds=seconds,
                scenes_per_second=size / seconds, turns=turns, versions=place.versions,
            )  # fmt: skip
            table.add(row)
            say(f"{entry.name:28} {size:3} scenes at once: {row.scenes_per_second:.2f} a second")


def _found(table: Table[BatchRow], entry: Entry, judged: str, size: int, place: Place) -> BatchRow | None:
    return table.find(
        name=entry.name, identity=entry.identity, judged=judged, batch=size, machine=place.machine,
        device=place.device, threads=place.threads,
    )  # fmt: skip
