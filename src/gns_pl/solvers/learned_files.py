"""Learned runs into files: scenes are stepped together, frames are written as they come, a broken run goes on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from gns_pl.data.places import check_reach
from gns_pl.models.geoelements import cold_start
from gns_pl.rollout.distributed import barrier, share_of_memory
from gns_pl.rollout.engine import Run, check_run, run_to_end, unroll
from gns_pl.rollout.failure import Watch
from gns_pl.rollout.memory import check_memory
from gns_pl.rollout.progress import counting
from gns_pl.rollout.stepper import Stepper
from gns_pl.scene import Scene
from gns_pl.solvers.ood import ood_message
from gns_pl.solvers.recording import Recording

if TYPE_CHECKING:
    from gns_pl.solvers.learned import LearnedSolver


def record(
    solver: LearnedSolver,
    scenes: Sequence[Scene],
    paths: Sequence[Path],
    *,
    interval: float,
    seed: int,
    monitor: bool,
    rank: int = 0,
) -> None:
    """As `LearnedSolver.record`; arguments and errors as those of `Solver.record`."""
    barrier()  # nobody looks at files that another run is still writing: the first process holds the folder's lock
    stepper = solver.policy.stepper(solver.checkpoint, shared=True)
    reductions = [solver.reduced(scene) for scene in scenes]
    recordings = []
    for scene, path, reduction in zip(scenes, paths, reductions, strict=True):
        start = solver.start(reduction.scene, seed, {**solver.facts(scene), "seed": seed})
        steps = solver.num_steps(reduction.scene)
        recordings.append(Recording.of(path, start, reduction, steps, history=stepper.history_length))
    runs = [Run(recording.start, recording.num_steps, recording.past, recording.made) for recording in recordings]
    for run in runs:
        check_run(run, stepper.config)
        check_reach(run.start, stepper.config.connectivity_radius)
    barrier()  # all processes have seen the files as they were
    left = [(recording, run) for recording, run in zip(recordings, runs, strict=True) if not recording.is_done]
    watches = [_watch(solver, run) if monitor else None for _, run in left]
    if rank:
        with torch.inference_mode():
            deque(unroll(stepper, [run for _, run in left], rest=solver.policy.rest(), watches=watches), maxlen=0)
        return
    if left:
        _write(solver, stepper, [recording for recording, _ in left], [run for _, run in left], watches)
    for recording in recordings:
        if recording.is_done:
            print(f"{recording.path}: {f'complete {recording.ended}' if recording.ended else 'already complete'}")


def _watch(solver: LearnedSolver, run: Run) -> Watch:
    before = None if run.past is None else run.past[-1]
    return Watch(run.start, solver.interval, before=before, made=run.made, every=solver.policy.every)


def _write(
    solver: LearnedSolver,
    stepper: Stepper,
    recordings: Sequence[Recording],
    runs: Sequence[Run],
    watches: Sequence[Watch | None],
) -> None:
    """Make the steps of all runs together and close every file when its scene is done."""
    intervals = ", ".join(sorted({f"{recording.interval:.3g}" for recording in recordings}))
    dt = max(recording.interval for recording in recordings)
    for recording in recordings:
        if recording.reduction.description:
            print(f"{recording.start.scene.name}: {recording.reduction.description}")
    if notice := cold_start(stepper.config, solver.provenance):
        print(notice)
    needs = check_memory(stepper, list(runs), share=share_of_memory(stepper.device))
    total = max(run.num_steps for run in runs)
    label = ", ".join(run.start.scene.name for run in runs)
    past = ", ".join(f"{recording.made * recording.interval:.4g} s" for recording in recordings)
    known = f" after {past}" if any(recording.source for recording in recordings) else ""
    print(f"{label}: {total} steps of {intervals} s{known}; {needs}", flush=True)
    for recording in recordings:
        recording.open()
    how = {"device": str(stepper.device), "num_threads": torch.get_num_threads()}
    frames = dict.fromkeys(range(len(runs)), 0)

    def on_frame(number: int, position: NDArray[np.float32]) -> None:
        frames[number] += 1
        recordings[number].append(position)

    def on_end(number: int, ending: dict[str, object]) -> None:
        if "at_rest_from" in ending and not solver.policy.rest_speed:
            recordings[number].fill(runs[number].num_steps - frames[number])
        text = recordings[number].finish({**how, **ending})
        print(f"{recordings[number].path}: {text}", flush=True)

    began = time.perf_counter()
    try:
        with counting(label, dt) as show:
            steps = run_to_end(
                stepper,
                runs,
                rest=solver.policy.rest(),
                watches=watches,
                on_frame=on_frame,
                on_end=on_end,
                on_step=show,
            )
    finally:
        for recording in recordings:
            recording.close()
    seconds = time.perf_counter() - began
    print(f"{steps} steps in {seconds:.1f} s: {steps / seconds:.3g} steps/s, {steps * dt / seconds:.3g} simulated s/s")
    for recording in recordings:
        if message := ood_message(solver.checkpoint, recording.path, recording.reduction):
            print(f"{recording.path}: {message}; verify it with MPM.")
