"""Simulations on a GPU: many scenes in one launch, since a single one leaves most of it idle."""

from __future__ import annotations

import time
import warnings
from collections.abc import Generator, Mapping, Sequence
from functools import partial

from gns_pl.generation.pool import Failure, attempt
from gns_pl.generation.produce import Job, Result, measure_files, produce, store
from gns_pl.mpm import settings as solver

BATCH_BYTES = 4_000_000_000
"""Positions that one launch leaves in the memory of this process. Some 25 fine cube drops (30,000 points, 401 frames)
fit, which keeps a GPU busy; what the device itself holds, some hundred bytes for each of their points, is far less."""


def run_batches(jobs: Sequence[Job]) -> Generator[tuple[int, Result | Failure], None, None]:
    """Make what is missing of every job in batches and yield (index of the job, result or `Failure`), as `run_jobs`.

    If a batch fails, its scenes are run one by one, so that only those that cannot be run are lost.

    Args:
        jobs: with one solver's settings and one frame interval.
    """
    finished = {index for index, job in enumerate(jobs) if job.is_made()}
    for index in finished:
        yield index, attempt(measure_files, jobs[index])
    sizes = {index: job.num_bytes for index, job in enumerate(jobs) if index not in finished}
    for batch in group(sizes, BATCH_BYTES):
        scenes, seeds = [jobs[index].scene for index in batch], [jobs[index].seed for index in batch]
        first, start = jobs[batch[0]], time.perf_counter()
        try:
            simulated = solver.run_batch(scenes, first.mpm, frame_interval=first.frame_interval, seeds=seeds)
        except Exception as error:
            warnings.warn(f"{len(batch)} scenes at once failed on the GPU ({error}); they go one by one.", stacklevel=2)
            for index in batch:
                yield index, attempt(produce, jobs[index])
            continue
        seconds, whole = time.perf_counter() - start, sum(sizes[index] for index in batch)
        for index, trajectory in zip(batch, simulated, strict=True):
            share = seconds * sizes[index] / whole
            yield index, attempt(partial(store, trajectory=trajectory, wall_seconds=share), jobs[index])


def group(sizes: Mapping[int, float], limit: float) -> list[list[int]]:
    """Return the keys of `sizes` in batches of neighbours that add up to at most `limit`, or are alone.

    Args:
        sizes: key → size, in order.
        limit: of a batch, in the same unit.
    """
    batches: list[list[int]] = []
    room = 0.0
    for index, size in sizes.items():
        if not batches or size > room:
            batches.append([])
            room = limit
        batches[-1].append(index)
        room -= size
    return batches
