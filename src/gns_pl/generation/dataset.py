"""`generate_dataset`: a folder of trajectories from a specification, made by all cores, safe to kill at any moment.

What a folder holds: `generation.json` (written first: the specification and the solver's version), one HDF5 file per
trajectory, `timings.csv`, and `manifest.json`, written last. A file is there whole or not at all, so whatever is
missing is what remains to be done.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from gns_pl.data.statistics import RunningStatistics
from gns_pl.errors import InputError
from gns_pl.generation import solver
from gns_pl.generation.lock import locked
from gns_pl.generation.pool import Failure, available_cores, run_jobs
from gns_pl.generation.produce import Job, Product, produce
from gns_pl.generation.progress import GenerationProgress
from gns_pl.generation.records import append_timing, check_folder, claim_folder, is_finished, write_failures
from gns_pl.generation.spec import DatasetSpec, Planned, draw_plan
from gns_pl.io import SPLITS, Manifest, StorageError, remove_temporary_files, write_manifest
from gns_pl.io.manifest import MANIFEST_VERSION
from gns_pl.scene import fill_scene


def generate_dataset(
    spec: Mapping[str, Any], *, root: str | Path | None = None, num_workers: int | None = None, progress: bool = True
) -> Path:
    """Make the data set of `spec`, or what is missing of it, and return its folder.

    A finished set is recognised at once. A killed run goes on where it was. Two processes on the same folder take
    turns. A trajectory that fails is named at the end, when all others are done.

    Args:
        spec: a `DatasetSpec` as plain values; "root" in it is the folder.
        root: the folder, if "root" is not to be used; relative to the working directory.
        num_workers: number of processes; None takes all cores.
        progress: tell on stderr what is coming and how long it takes.

    Raises:
        InputError: a specification that cannot be used, a folder that holds something else, or failed trajectories.
        StorageError: the disk refuses.
    """
    dataset = DatasetSpec.from_dict(spec)
    place = spec.get("root") if root is None else root
    if not isinstance(place, str | Path) or not str(place):
        raise InputError("data: root must name the folder of the data set.")
    folder = Path(place)
    if is_finished(folder, dataset):
        return folder
    plan = draw_plan(dataset)
    spacing = solver.solver_config(dataset.mpm).spacing
    check_folder(folder, dataset)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder}: cannot be made ({error.strerror}).") from error
    talk = GenerationProgress(dataset.name, {}, 1, enabled=progress)
    with locked(folder / ".lock", lambda: talk.say(f"{folder}: another process is generating it; waiting for it.")):
        if not is_finished(folder, dataset):
            claim_folder(folder, dataset)
            remove_temporary_files(folder)
            _generate(folder, dataset, plan, spacing, num_workers, progress)
    return folder


def _generate(
    folder: Path, dataset: DatasetSpec, plan: Sequence[Planned], spacing: float, num_workers: int | None, progress: bool
) -> None:
    todo = [planned for planned in plan if not (folder / planned.file_name).exists()]
    particles = {planned.file_name: len(fill_scene(planned.scene, spacing).position) for planned in plan}
    work = {planned.file_name: particles[planned.file_name] * planned.scene.duration for planned in todo}
    size = sum(4 * planned.scene.dim * work[planned.file_name] / dataset.frame_interval for planned in todo)
    _check_space(folder, size)
    order = sorted(plan, key=lambda planned: -work.get(planned.file_name, float("inf")))  # long ones early: no tail
    jobs = [_job(folder, dataset, planned) for planned in order]
    workers = max(1, min(num_workers or available_cores(), len(jobs)))
    products: dict[str, Product] = {}
    failures: dict[str, Failure] = {}
    with GenerationProgress(dataset.name, work, workers, enabled=progress) as told:
        told.say(
            f"{dataset.name}: {len(plan)} trajectories, {sum(particles.values()):,} particles in all, into {folder}; "
            f"{len(todo)} to simulate ({size / 1e9:.2g} GB) by {workers} process{'es' if workers > 1 else ''}."
        )
        if todo:
            solver.compile_solver(todo[0].scene, dataset.mpm, frame_interval=dataset.frame_interval)
        with closing(run_jobs(produce, jobs, workers)) as outcomes:
            for index, outcome in outcomes:
                name = jobs[index].path.name
                if isinstance(outcome, Failure):
                    failures[name] = outcome
                    told.say(f"{name} failed: {outcome.sentence}")
                    if outcome.final:
                        break
                else:
                    products[name] = outcome
                    if outcome.wall_seconds is not None:
                        append_timing(folder, name, outcome.wall_seconds)
                if name in work:
                    told.finish(name)
    remove_temporary_files(folder)  # of processes ended because the disk is full
    write_failures(folder, failures)
    _raise_failures(folder, failures, len(plan))
    write_manifest(folder, _manifest(dataset, plan, products, spacing))
    told.say(f"{dataset.name}: {len(plan)} trajectories are in {folder}.")


def _job(folder: Path, dataset: DatasetSpec, planned: Planned) -> Job:
    return Job(
        path=folder / planned.file_name,
        scene=planned.scene,
        mpm=dataset.mpm,
        frame_interval=dataset.frame_interval,
        seed=planned.seed,
        provenance={"dataset": dataset.name, "solver_version": solver.solver_version()},
    )


def _check_space(folder: Path, size: float) -> None:
    free = shutil.disk_usage(folder).free
    if size > free:
        raise StorageError(f"{folder}: needs about {size / 1e9:.2g} GB, and only {free / 1e9:.2g} GB are free there.")


def _raise_failures(folder: Path, failures: Mapping[str, Failure], total: int) -> None:
    final = [failure for failure in failures.values() if failure.final]
    if final:
        raise StorageError(final[0].sentence)
    if failures:
        name, first = next(iter(sorted(failures.items())))
        raise InputError(
            f"{folder}: {len(failures)} of {total} trajectories failed ({', '.join(sorted(failures)[:5])}"
            f"{', …' if len(failures) > 5 else ''}; {name}: {first.sentence.rstrip('.')}); "
            f"the others are kept and will not be made again, and failures.log says more."
        )


def _manifest(
    dataset: DatasetSpec, plan: Sequence[Planned], products: Mapping[str, Product], spacing: float
) -> Manifest:
    dim = plan[0].scene.dim
    statistics = {"velocity": RunningStatistics(dim), "acceleration": RunningStatistics(dim)}
    for planned in plan:  # in the order of the files, so that the sums are always the same
        if planned.split == "train":
            for quantity, seen in statistics.items():
                seen.merge(products[planned.file_name].statistics[quantity])
    return Manifest(
        format_version=MANIFEST_VERSION,
        name=dataset.name,
        dt=dataset.frame_interval,
        dim=dim,
        spacing=spacing,
        particle_types=tuple(sorted({kind for product in products.values() for kind in product.particle_types})),
        material_features=products[plan[0].file_name].material_features,
        splits={split: tuple(p.file_name for p in plan if p.split == split) for split in SPLITS},
        files={planned.file_name: products[planned.file_name].record for planned in plan},
        statistics={quantity: seen.to_dict() for quantity, seen in statistics.items()},
        seed=dataset.seed,
        spec=json.loads(json.dumps(dataset.to_dict())),
    )
