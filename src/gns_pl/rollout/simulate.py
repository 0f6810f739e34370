"""Scenes in, trajectory files out: a learned simulator as a tool. What was written is never computed again."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

import gns_pl
from gns_pl.checkpoint import load_checkpoint, move
from gns_pl.errors import InputError
from gns_pl.frame_simulator import cold_start
from gns_pl.generation.lock import locked
from gns_pl.io import StorageError, file_sha256, read_window
from gns_pl.io.stream import TrajectoryStream, find_frames, go_on
from gns_pl.pretrained import find_checkpoint, pretrained_names
from gns_pl.rollout.acceleration import accelerate
from gns_pl.rollout.distributed import SlabSimulator, meet, processes, share_of_memory
from gns_pl.rollout.engine import Run, check_run, unroll
from gns_pl.rollout.failure import Failure, Watch
from gns_pl.rollout.familiarity import told
from gns_pl.rollout.fitted import start_of
from gns_pl.rollout.memory import check_memory
from gns_pl.rollout.progress import counting
from gns_pl.rollout.rest import STEPS, Rest
from gns_pl.rollout.stabilise import stabilise as stabilised
from gns_pl.scene import Material, Scene, Wall, column_collapse, part_from_dict, read_scene
from gns_pl.simulator import Simulator
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
    """

    path: Path
    run: Run
    source: Path | None
    ended: str


def simulate_config(cfg: DictConfig) -> list[Path]:
    """Simulate as a Hydra config says (conf/simulate.yaml)."""
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    ckpt, named, tolerance = (settings.pop(key) for key in ("ckpt", "scene", "tolerance"))
    catalogue, choice, explain, way = (settings.pop(key) for key in ("catalogue", "choice", "explain", "way"))
    settings.pop("paper")
    chooses = tolerance is not None or explain or way is not None
    if not named or not (ckpt or chooses):
        raise InputError(
            "which scene, and by which way? python simulate.py scene=column_collapse tolerance=0.05, or ckpt=collapse "
            "scene=FILE.yaml"
        )
    settings["out"] = Path(settings["out"])
    checkpoint = find_checkpoint(ckpt) if ckpt else None
    if checkpoint is not None and not checkpoint.is_file():
        known = ", ".join(pretrained_names())
        raise InputError(f"{checkpoint}: there is no such checkpoint; those that come with gns_pl are {known}.")
    scenes = [_named_scene(each, catalogue) for each in ([named] if isinstance(named, str) else named)]
    if checkpoint is None:
        from gns_pl.rollout.by_choice import simulate_by_choice

        kept = {key: settings[key] for key in ("out", "duration", "seed", "rest_speed", "stabilise")}
        return simulate_by_choice(scenes, tolerance=tolerance, explain=explain, way=way, **choice, **kept)
    if chooses:
        raise InputError("ckpt= names the way already; leave it out, and tolerance=, way=, explain= choose one.")
    return simulate(checkpoint, scenes, **settings)


def _named_scene(name: str, catalogue: Mapping[str, Any]) -> Scene:
    """Return a scene of the catalogue (conf/simulate.yaml), or of a file."""
    if name not in catalogue:
        return read_scene(Path(name))
    parts = dict(catalogue[name])
    gravity, height = float(parts["gravity"]), parts["length"] * parts["aspect_ratio"]
    sides = {"y-": parts["side_walls"], "y+": parts["side_walls"]} if parts["side_walls"] else {}
    return column_collapse(
        domain=parts["domain"],
        length=parts["length"],
        height=height,
        gravity=gravity,
        duration=parts["duration_tau"] * math.sqrt(height / gravity),
        material=part_from_dict(Material, "material", parts["material"]),
        walls={face: part_from_dict(Wall, f"wall {face}", wall) for face, wall in {**parts["walls"], **sides}.items()},
        name=name,
    )


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
    with processes(fast.velocity_scale.device) as (rank, size), alone(out) if rank == 0 else nullcontext():
        meet()  # so that nobody looks at files another run is still writing
        simulator = stabilised(fast, step=SlabSimulator(fast) if size > 1 else None, **settings)
        starts = [start_of(scene, checkpoint, seed, identity) for scene in scenes]
        length = max(simulator.config.input_sequence_length, STEPS + 1)
        jobs = [_job(out / f"{start.scene.name}.h5", start, length) for start in starts]
        for job in jobs:
            check_run(job.run, simulator.config)
        left = [job for job in jobs if job.run.num_steps or job.source != job.path]
        meet()  # all have seen the files as they were
        rest = Rest(rest_speed) if rest_speed else None
        watches = [_watch(job.run, simulator.config.dt) if watch else None for job in left]
        if rank:
            with torch.inference_mode():
                deque(unroll(simulator, [job.run for job in left], rest=rest, watches=watches), maxlen=0)
            return [job.path for job in jobs]
        if left:
            if cold := cold_start(simulator.config, checkpoint.provenance):
                print(cold)
            _write(left, simulator, identity, rest, watches)
            for job in left:
                if sentence := told(checkpoint, job.path):
                    print(f"{job.path}: {sentence}; do not trust it without a look at MPM.")
    for job in jobs:
        if job not in left:
            print(f"{job.path}: is there {job.ended or 'whole'}")
    return [job.path for job in jobs]


def _watch(run: Run, dt: float) -> Watch:
    """Return what looks at every tenth frame of a run: all of them cost a small scene a tenth of its time."""
    before = None if run.past is None else run.past[-1]
    return Watch(run.start, dt, before=before, made=run.made, every=10)


def _job(path: Path, start: Trajectory, length: int) -> Job:
    """Return what is to do for a scene, after a look at what is there; a step needs `length` frames of it."""
    wanted = math.ceil(start.scene.duration / start.dt - 1e-6)
    found = find_frames(path)
    if found is None:
        return Job(path, Run(start, wanted), None, "")
    source, header = found
    same = (
        all(header.provenance.get(key) == value for key, value in start.provenance.items())
        and header.scene.replace(duration=start.scene.duration) == start.scene
        and np.array_equal(read_window(source, 0, 1), start.position)
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
    past = read_window(source, first, made + 1 - first)
    return Job(path, Run(start, left, past, made), source, ended)


def _write(
    jobs: Sequence[Job],
    simulator: Simulator,
    identity: Mapping[str, object],
    rest: Rest | None,
    watches: Sequence[Watch | None],
) -> None:
    """Make the steps of all jobs together and close every file when its scene is done."""
    dt = simulator.config.dt
    needs = check_memory(simulator, [job.run for job in jobs], share=share_of_memory(simulator.velocity_scale.device))
    streams = [_open(job) for job in jobs]
    total = max(job.run.num_steps for job in jobs)
    label = ", ".join(job.run.start.scene.name for job in jobs)
    known = " after " + ", ".join(f"{job.run.made * dt:g} s" for job in jobs) if any(j.source for j in jobs) else ""
    print(f"{label}: {total} steps of {dt:g} s{known}; {needs}", flush=True)
    made, began = 0, time.perf_counter()
    rested = rest.rested if rest else set()

    def finish(number: int, **more: object) -> None:
        device, threads = str(simulator.velocity_scale.device), torch.get_num_threads()
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
            for parts in unroll(simulator, [job.run for job in jobs], rest=rest, watches=watches):
                for number in sorted(open_jobs & rested):
                    finish_rested(number, made)
                made += 1
                for number in sorted(open_jobs):
                    looking = watches[number]
                    failure = looking.failure if looking else None
                    if number in parts:
                        streams[number].append(_frame(parts[number]))
                    elif failure is None:
                        when = (jobs[number].run.made + made) * dt
                        failure = Failure("not finite", when, f"positions were no longer finite at {when:.3g} s")
                    if failure is not None or jobs[number].run.num_steps == made:
                        open_jobs.remove(number)
                        failed = {"failed_at": failure.time, "failure": failure.sentence} if failure else {}
                        finish(number, **failed)
                        if failed:
                            print(f"{jobs[number].path}: no sand does this: {failed['failure']}; ended there.")
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


def prepare(out: Path, scenes: Sequence[Scene]) -> None:
    """Make the folder of scenes' files.

    Raises:
        InputError: two scenes of one name.
        StorageError: it cannot be made.
    """
    names = [scene.name for scene in scenes]
    if len(set(names)) < len(names):
        raise InputError(f"two scenes have the same name among {', '.join(names)}, and it names their files.")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{out}: cannot be made ({error.strerror}).") from error


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Be the only run that writes into a folder."""
    with locked(out / ".simulate.lock", on_wait=lambda: print(f"{out}: another run is writing here; waiting for it")):
        yield


def _open(job: Job) -> TrajectoryStream:
    if job.source is not None:
        return go_on(job.path, job.run.start, job.source, job.run.made + 1)
    stream = TrajectoryStream(job.path, job.run.start)
    stream.append(job.run.start.position)
    return stream


def _frame(position: torch.Tensor) -> NDArray[np.float32]:
    frame: NDArray[np.float32] = position.cpu().numpy()[None]
    return frame
