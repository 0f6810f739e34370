"""`generate_dataset`: a folder of trajectories from a specification, made by all cores or a GPU, safe to kill.

What a folder holds: `generation.json` (written first: the specification and the solver's version), one HDF5 file per
trajectory, `timings.csv`, and `manifest.json`, written last. A file is there whole or not at all, so whatever is
missing is what remains to be done. If every k-th lattice point is stored instead of all, each k has a folder `every_k`
of its own with files and manifest, a data set like any other.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from gns_pl.data.statistics import RunningStatistics
from gns_pl.errors import InputError
from gns_pl.generation import records
from gns_pl.generation.batches import run_batches
from gns_pl.generation.families import Planned, draw_plan
from gns_pl.generation.pool import Failure, run_jobs
from gns_pl.generation.produce import Job, MeasuredFile, OutputFile, Result, produce
from gns_pl.generation.progress import GenerationProgress
from gns_pl.generation.spec import DatasetSpec, chosen_every
from gns_pl.generation.thinning import stored_counts
from gns_pl.io import SPLITS, Manifest, StorageError, remove_temporary_files, write_manifest
from gns_pl.io.atomic import free_bytes
from gns_pl.io.lock import locked
from gns_pl.io.manifest import MANIFEST_VERSION
from gns_pl.machine import available_cores
from gns_pl.mpm import settings as solver
from gns_pl.scene.extent import compression_notice, largest_own_weight_strain, num_frames

NOTEWORTHY_BYTES = 100_000_000
"""What a process has in memory is told if it is more than this."""


def generate_dataset(
    spec: Mapping[str, Any],
    *,
    root: str | Path | None = None,
    num_workers: int | None = None,
    device: str = "cpu",
    progress: bool = True,
) -> Path:
    """Make the data set of `spec`, or what is missing of it, and return its folder.

    A finished set is recognised at once. A killed run goes on where it was. Two processes on the same folder take
    turns. A trajectory that fails is named at the end, when all others are done.

    Args:
        spec: a `DatasetSpec` as plain values; "root" in it is the folder, "every" which of those stored is wanted.
        root: the folder, if "root" is not to be used; relative to the working directory.
        num_workers: number of processes on the CPU; None takes all cores.
        device: "cpu", "cuda", or "auto": the GPU where there is one.
        progress: tell on stderr what is coming and how long it takes.

    Returns:
        The folder with the manifest; of those stored, the one that is wanted.

    Raises:
        InputError: a specification that cannot be used, a folder that holds something else, or failed trajectories.
        StorageError: the disk refuses.
    """
    dataset = DatasetSpec.from_dict(spec)
    directory = spec.get("root") if root is None else root
    if not isinstance(directory, str | Path) or not str(directory):
        raise InputError("data: root must name the folder of the data set.")
    folder = Path(directory)
    wanted = records.stored_folders(folder, dataset)[chosen_every(spec)]
    if records.is_finished(folder, dataset):
        return wanted
    spacing = solver.solver_config(dataset.mpm).spacing
    device = solver.choose_device(device)
    plan = draw_plan(dataset)
    jobs = [_job(folder, dataset, planned, spacing, device) for planned in plan]
    records.check_folder(folder, dataset)
    records.make_folder(folder)
    reporter = GenerationProgress(dataset.name, {}, 1, enabled=progress)
    waiting = f"{folder}: another process is generating it; waiting for it."
    with locked(folder / ".lock", lambda: reporter.log(waiting)) as held:
        if not records.is_finished(folder, dataset):
            records.claim_folder(folder, dataset)
            folders = {folder, *records.stored_folders(folder, dataset).values()} if held else ()
            with _without_leftovers(folders):
                _generate(folder, dataset, plan, jobs, num_workers, progress)
    return wanted


def missing_bytes(spec: Mapping[str, Any]) -> int:
    """Return the positions that `generate_dataset` would write [bytes].

    Args:
        spec: a `DatasetSpec` as plain values, with "root".

    Raises:
        InputError: a specification that cannot be used.
    """
    dataset, folder = DatasetSpec.from_dict(spec), Path(spec["root"])
    spacing = solver.solver_config(dataset.mpm).spacing
    return sum(_job(folder, dataset, planned, spacing, "cpu").missing_bytes() for planned in draw_plan(dataset))


@contextmanager
def _without_leftovers(folders: Collection[Path]) -> Iterator[None]:
    """Remove what killed processes left half-written, before and after; also those ended because the disk is full."""
    for folder in folders:
        remove_temporary_files(folder)
    try:
        yield
    finally:
        for folder in folders:
            remove_temporary_files(folder)


def _job(folder: Path, dataset: DatasetSpec, planned: Planned, spacing: float, device: str) -> Job:
    num_frames(planned.scene, dataset.frame_interval)  # refuses a scene that is shorter than a frame
    num_points, stored = stored_counts(planned.scene, spacing, planned.offsets)
    return Job(
        name=planned.file_name,
        outputs=tuple(
            OutputFile(directory / planned.file_name, every, planned.offsets[every], stored[every])
            for every, directory in records.stored_folders(folder, dataset).items()
        ),
        scene=planned.scene,
        num_points=num_points,
        mpm=dataset.mpm,
        frame_interval=dataset.frame_interval,
        seed=planned.seed,
        device=device,
        provenance={"dataset": dataset.name, "solver_version": solver.solver_version(dataset.mpm), "device": device},
    )


def _generate(
    folder: Path,
    dataset: DatasetSpec,
    plan: Sequence[Planned],
    jobs: Sequence[Job],
    num_workers: int | None,
    progress: bool,
) -> None:
    work = {job.name: job.num_bytes for job in jobs if not job.is_made()}
    order = sorted(jobs, key=lambda job: -work.get(job.name, float("inf")))  # long ones early: no tail
    on_gpu = jobs[0].device == "cuda"
    workers = 1 if on_gpu else max(1, min(num_workers or available_cores(), len(jobs)))
    results: dict[str, Result] = {}
    failures: dict[str, Failure] = {}
    reporter = GenerationProgress(dataset.name, work, workers, enabled=progress)
    reporter.log(_announcement(folder, dataset, jobs, workers))
    worst = max((job.scene for job in jobs), key=largest_own_weight_strain)
    notice = compression_notice(worst)
    if notice is not None:
        reporter.log(f"{notice}.")
    _check_space(folder, sum(job.missing_bytes() for job in jobs))
    if work and not on_gpu:  # before the clock starts: every process finds the kernels compiled
        solver.compile_solver(order[-1].scene, dataset.mpm, frame_interval=dataset.frame_interval)
    with reporter, closing(run_batches(order) if on_gpu else run_jobs(produce, order, workers)) as outcomes:
        for index, outcome in outcomes:
            name = order[index].name
            if isinstance(outcome, Failure):
                failures[name] = outcome
                reporter.log(f"{name} failed: {outcome.message}")
                if outcome.final:
                    break
            else:
                results[name] = outcome
                if outcome.wall_seconds is not None:
                    records.append_timing(folder, name, outcome.wall_seconds)
            if name in work:
                reporter.finish(name)
    stored = records.stored_folders(folder, dataset)
    records.write_failures(folder, failures)
    _raise_failures(folder, failures, len(plan))
    for every, directory in stored.items():
        files = {name: result.files[every] for name, result in results.items()}
        write_manifest(directory, _manifest(dataset, plan, files, every))
    reporter.log(f"{dataset.name}: {len(plan)} trajectories are in {folder}.")


def _announcement(folder: Path, dataset: DatasetSpec, jobs: Sequence[Job], workers: int) -> str:
    todo = [job for job in jobs if not job.is_made()]
    particles, size = sum(job.num_points for job in jobs), sum(job.missing_bytes() for job in jobs)
    thinned = "" if dataset.store_every == (1,) else f", every {' and every '.join(map(str, dataset.store_every))}"
    if jobs[0].device == "cuda":
        where = "on the GPU"
    else:
        where = f"by {workers} process{'es' if workers > 1 else ''}"
        held = max((job.num_bytes for job in todo), default=0)
        if held > NOTEWORTHY_BYTES:  # a simulation is in memory whole, so all cores may be too many processes
            where += f", each with up to {held / 1e9:.2g} GB of positions in memory"
    return (
        f"{dataset.name}: {len(jobs)} trajectories, {particles:,} particles in all, into {folder}; "
        f"{len(todo)} to simulate ({size / 1e9:.2g} GB{thinned}) {where}."
    )


def _check_space(folder: Path, size: float) -> None:
    free = free_bytes(folder)
    if size > free:
        raise StorageError(f"{folder}: needs about {size / 1e9:.2g} GB, and only {free / 1e9:.2g} GB are free there.")


def _raise_failures(folder: Path, failures: Mapping[str, Failure], total: int) -> None:
    final = [failure for failure in failures.values() if failure.final]
    if final:
        raise StorageError(final[0].message)
    if failures:
        name, first = next(iter(sorted(failures.items())))
        raise InputError(
            f"{folder}: {len(failures)} of {total} trajectories failed ({', '.join(sorted(failures)[:5])}"
            f"{', …' if len(failures) > 5 else ''}; {name}: {first.message.rstrip('.')}); "
            f"the others are kept and will not be made again, and failures.log says more."
        )


def _manifest(dataset: DatasetSpec, plan: Sequence[Planned], files: Mapping[str, MeasuredFile], every: int) -> Manifest:
    dim = plan[0].scene.dim
    statistics = {"velocity": RunningStatistics(dim), "acceleration": RunningStatistics(dim)}
    for planned in plan:  # in the order of the files, so that the sums are always the same
        if planned.split == "train":
            for quantity, moments in statistics.items():
                moments.merge(files[planned.file_name].statistics[quantity])
    return Manifest(
        format_version=MANIFEST_VERSION,
        name=dataset.name,
        dt=dataset.frame_interval,
        dim=dim,
        spacing=every * solver.solver_config(dataset.mpm).spacing,
        particle_types=tuple(sorted({kind for measured in files.values() for kind in measured.particle_types})),
        material_features=files[plan[0].file_name].material_features,
        splits={split: tuple(p.file_name for p in plan if p.split == split) for split in SPLITS},
        files={planned.file_name: files[planned.file_name].record for planned in plan},
        statistics={quantity: moments.to_dict() for quantity, moments in statistics.items()},
        seed=dataset.seed,
        spec=json.loads(json.dumps(dataset.to_dict())),
    )
