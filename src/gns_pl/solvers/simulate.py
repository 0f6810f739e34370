"""Scenes in, trajectory files out: a learned simulator as a tool. What was written is never computed again."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

import gns_pl
from gns_pl.data.places import check_reach
from gns_pl.errors import InputError
from gns_pl.io import file_sha256, read_window
from gns_pl.io.stream import TrajectoryStream, find_frames, go_on
from gns_pl.models.checkpoint import load_checkpoint, move
from gns_pl.models.geoelements import cold_start
from gns_pl.models.shipped import corrector_names, existing_checkpoint, find_checkpoint, is_corrector
from gns_pl.rollout.acceleration import accelerate
from gns_pl.rollout.distributed import barrier, distribute, processes, share_of_memory
from gns_pl.rollout.engine import Run, check_run, unroll
from gns_pl.rollout.failure import Failure, Watch
from gns_pl.rollout.memory import check_memory
from gns_pl.rollout.progress import counting
from gns_pl.rollout.rest import Rest
from gns_pl.rollout.stabilise import stabilise as stabilised
from gns_pl.rollout.stepper import Stepper
from gns_pl.scene import Scene
from gns_pl.scene.changes import decoded
from gns_pl.solvers.familiarity import told
from gns_pl.solvers.folder import alone, prepare
from gns_pl.solvers.learned import plane_of, start_of
from gns_pl.solvers.named_scene import named_scene
from gns_pl.solvers.reduction import Reduction
from gns_pl.text import command
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from omegaconf import DictConfig


@dataclass(frozen=True)
class Job:
    """A scene, its file, and how far it is.

    Attributes:
        path: the file.
        run: what is left to do.
        source: file that holds the frames made before; None if there are none.
        ended: why and when an earlier run of it ended before its time, in words; empty if it did not.
        reduction: from the scene of the file to the one that is run.
    """

    path: Path
    run: Run
    source: Path | None
    ended: str
    reduction: Reduction


def simulate_config(cfg: DictConfig, *, label: str = "") -> list[Path]:
    """Simulate as a Hydra config says (conf/simulate.yaml).

    Args:
        cfg: the config.
        label: what tells this job from the others of a sweep; it goes into the names of the files.
    """
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    changes = decoded(settings.pop("changes"))
    ckpt, named, tolerance = (settings.pop(key) for key in ("ckpt", "scene", "tolerance"))
    catalogue, choice, explain, way = (settings.pop(key) for key in ("catalogue", "choice", "explain", "solver"))
    cell_size, check = settings.pop("cell_size"), settings.pop("check")
    for key in ("paper", "way", "report", "reporting"):
        settings.pop(key)
    chooses = tolerance is not None or explain or way is not None or cell_size is not None
    if isinstance(ckpt, str) and not chooses and (ckpt in choice["handed"] or is_corrector(ckpt)):
        from gns_pl.solvers.catalogue import way_name

        choice["corrected"] = [ckpt] if is_corrector(ckpt) else []
        way = way_name(ckpt)
        ckpt = None
    if not named or not (ckpt or way or chooses):
        raise InputError(
            f"give scene= and either ckpt= or tolerance=: {command('simulate')} scene=column_collapse tolerance=0.05"
        )
    settings["out"] = Path(settings["out"])
    if isinstance(ckpt, list):
        raise InputError(
            f"ckpt={','.join(map(str, ckpt))}: a run takes one checkpoint; -m ckpt=A,B makes a run of each."
        )
    checkpoint = existing_checkpoint(ckpt, [*corrector_names(), *choice["handed"]]) if ckpt else None
    scenes = [named_scene(each, catalogue, changes, label) for each in ([named] if isinstance(named, str) else named)]
    if checkpoint is None:
        from gns_pl.solvers.catalogue import simulate_by_choice

        kept = {key: settings[key] for key in ("out", "duration", "seed", "rest_speed", "stabilise", "device")}
        kept |= {"cell_size": cell_size, "check": check}
        return simulate_by_choice(scenes, tolerance=tolerance, explain=explain, way=way, **choice, **kept)
    if chooses or check:
        raise InputError(
            "ckpt= names the way already; leave it out, and tolerance=, solver=, explain= choose one (cell_size= and "
            "check= are MPM's)."
        )
    return simulate(checkpoint, scenes, **settings)


def simulate(
    checkpoint_path: str | Path,
    scenes: Sequence[Scene],
    *,
    out: Path,
    duration: float | None = None,
    seed: int = 0,
    rest_speed: float = 0.0,
    device: str = "auto",
    acceleration: Mapping[str, Any] | None = None,
    stabilise: Mapping[str, Any] | None = None,
    watch: bool = True,
) -> list[Path]:
    """Run scenes together in a learned simulator, every frame into `out`/NAME.h5 as soon as it is made.

    A file that is there, finished or broken off, is gone on with from its last frame, if it is of the same scene,
    checkpoint and seed; the result is then the one of a single run.

    Args:
        checkpoint_path: the simulator, a file or the name of one that comes with the package.
        scenes: what to simulate; their names name the files.
        out: folder; made.
        duration: simulated time of every scene [s]; None takes each scene's own.
        seed: of the particles' placement.
        rest_speed: a scene ends when all its particles were slower for some steps [m/s]; 0 makes all steps.
        device: "auto", or a device as torch names it.
        acceleration: arguments of `rollout.acceleration.accelerate`.
        stabilise: arguments of `rollout.stabilise.stabilise`.
        watch: what fails all the same ends with a sentence (`failure`); False goes on as long as numbers are finite.

    Returns:
        The files, in the order of the scenes.

    Raises:
        InputError: a checkpoint or a scene that cannot be used, or a file of another run in the place of one.
        StorageError: the disk refuses; the frames written stay.
    """
    checkpoint_path = find_checkpoint(checkpoint_path)
    checkpoint = load_checkpoint(checkpoint_path)
    prepare(out, scenes)
    identity = {
        "solver": "gns_pl.rollout",
        "version": gns_pl.__version__,
        "checkpoint": checkpoint_path.name,
        "checkpoint_sha256": file_sha256(checkpoint_path),
        "seed": seed,
    }
    if duration is not None:
        scenes = [scene.replace(duration=duration) for scene in scenes]
    move(checkpoint, device, "device")
    fast, settings = accelerate(checkpoint.simulator, **(acceleration or {})), dict(stabilise or {})
    with processes(fast.device) as (rank, _), alone(out) if rank == 0 else nullcontext():
        barrier()  # so that nobody looks at files another run is still writing
        stepper = stabilised(distribute(fast), **settings)
        reductions = [plane_of(scene, stepper.config.dim) for scene in scenes]
        starts = [start_of(each.scene, checkpoint, seed, identity) for each in reductions]
        jobs = [
            _job(out / f"{start.scene.name}.h5", start, stepper.history_length, reduction)
            for start, reduction in zip(starts, reductions, strict=True)
        ]
        for job in jobs:
            check_run(job.run, stepper.config)
            check_reach(job.run.start, stepper.config.connectivity_radius)
        left = [job for job in jobs if job.run.num_steps or job.source != job.path]
        barrier()  # all have seen the files as they were
        rest = Rest(rest_speed) if rest_speed else None
        watches = [_watch(job.run, stepper.config.dt) if watch else None for job in left]
        if rank:
            with torch.inference_mode():
                deque(unroll(stepper, [job.run for job in left], rest=rest, watches=watches), maxlen=0)
            return [job.path for job in jobs]
        if left:
            for job in left:
                if job.reduction.words:
                    print(f"{job.run.start.scene.name}: {job.reduction.words}")
            if notice := cold_start(stepper.config, checkpoint.provenance):
                print(notice)
            _write(left, stepper, identity, rest, watches)
            for job in left:
                if sentence := told(checkpoint, job.path, job.reduction):
                    print(f"{job.path}: {sentence}; verify it with MPM.")
    for job in jobs:
        if job not in left:
            print(f"{job.path}: {f'complete {job.ended}' if job.ended else 'already complete'}")
    return [job.path for job in jobs]


def _watch(run: Run, dt: float) -> Watch:
    """Return what looks at every tenth frame of a run: all of them cost a small scene a tenth of its time."""
    before = None if run.past is None else run.past[-1]
    return Watch(run.start, dt, before=before, made=run.made, every=10)


def _job(path: Path, start: Trajectory, length: int, reduction: Reduction) -> Job:
    """Return what is to do for a scene, after a look at what is there; a step needs `length` frames of it."""
    whole = reduction.lift(start)
    wanted = math.ceil(start.scene.duration / start.dt - 1e-6)
    found = find_frames(path)
    if found is None:
        return Job(path, Run(start, wanted), None, "", reduction)
    source, header = found
    same = (
        all(header.provenance.get(key) == value for key, value in start.provenance.items())
        and header.scene.replace(duration=whole.scene.duration) == whole.scene
        and np.array_equal(read_window(source, 0, 1), whole.position)
    )
    if not same:
        raise InputError(
            f"{source}: is of another scene, checkpoint, seed or version; remove it or choose another out=."
        )
    made = header.num_frames - 1
    failed_at, rested = (header.provenance.get(key) for key in ("failed_at", "at_rest_from"))
    ended = f"until it failed at {failed_at:g} s" if isinstance(failed_at, float) else ""
    ended = f"until it came to rest at {rested:g} s" if isinstance(rested, float) else ended
    left = 0 if ended else max(0, wanted - made)
    first = max(0, made + 1 - length)
    past = reduction.project(read_window(source, first, made + 1 - first))
    return Job(path, Run(start, left, past, made), source, ended, reduction)


def _write(
    jobs: Sequence[Job],
    stepper: Stepper,
    identity: Mapping[str, object],
    rest: Rest | None,
    watches: Sequence[Watch | None],
) -> None:
    """Make the steps of all jobs together and close every file when its scene is done."""
    dt = stepper.config.dt
    needs = check_memory(stepper, [job.run for job in jobs], share=share_of_memory(stepper.device))
    streams = [_open(job) for job in jobs]
    total = max(job.run.num_steps for job in jobs)
    label = ", ".join(job.run.start.scene.name for job in jobs)
    known = " after " + ", ".join(f"{job.run.made * dt:g} s" for job in jobs) if any(j.source for j in jobs) else ""
    print(f"{label}: {total} steps of {dt:g} s{known}; {needs}", flush=True)
    made, began = 0, time.perf_counter()
    rested = rest.rested if rest else set()

    def finish(number: int, **more: object) -> None:
        device, threads = str(stepper.device), torch.get_num_threads()
        seconds = time.perf_counter() - began
        provenance = {**identity, "wall_seconds": seconds, "device": device, "num_threads": threads, **more}
        streams[number].finish(provenance)
        ended = f", at rest from {more['at_rest_from']:g} s" if "at_rest_from" in more else ""
        print(f"{jobs[number].path}: {streams[number].num_frames} frames{ended}", flush=True)

    def finish_rested(number: int, steps: int) -> None:
        open_jobs.remove(number)
        finish(number, at_rest_from=(jobs[number].run.made + steps) * dt)

    try:
        with counting(label, dt) as show, torch.inference_mode():
            open_jobs = {number for number, job in enumerate(jobs) if job.run.num_steps}
            for number in set(range(len(jobs))) - open_jobs:
                finish(number)  # killed between its last frame and its name
            for parts in unroll(stepper, [job.run for job in jobs], rest=rest, watches=watches):
                for number in sorted(open_jobs & rested):
                    finish_rested(number, made)
                made += 1
                for number in sorted(open_jobs):
                    looking = watches[number]
                    failure = looking.failure if looking else None
                    if number in parts:
                        streams[number].append(_frame(parts[number], jobs[number]))
                    elif failure is None:
                        when = (jobs[number].run.made + made) * dt
                        failure = Failure("not finite", when, f"positions were no longer finite at {when:.3g} s")
                    if failure is not None or jobs[number].run.num_steps == made:
                        open_jobs.remove(number)
                        failed = {"failed_at": failure.time, "failure": failure.message} if failure else {}
                        finish(number, **failed)
                        if failed:
                            print(f"{jobs[number].path}: unphysical state: {failed['failure']}; run stopped.")
                show(made, total)
            for number in sorted(open_jobs):
                finish_rested(number, made)
    except KeyboardInterrupt:
        raise SystemExit("simulate.py: stopped; the same command goes on where it was.") from None
    finally:
        for stream in streams:
            stream.close()
    seconds = time.perf_counter() - began
    print(f"{made} steps in {seconds:.1f} s: {made / seconds:.3g} steps/s, {made * dt / seconds:.3g} simulated s/s")


def _open(job: Job) -> TrajectoryStream:
    start = job.reduction.lift(job.run.start)
    if job.source is not None:
        return go_on(job.path, start, job.source, job.run.made + 1)
    stream = TrajectoryStream(job.path, start)
    stream.append(start.position)
    return stream


def _frame(position: torch.Tensor, job: Job) -> NDArray[np.float32]:
    frame: NDArray[np.float32] = position.cpu().numpy()[None]
    return job.reduction.lift(replace(job.run.start, position=frame)).position if job.reduction.words else frame
