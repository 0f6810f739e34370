"""What a rollout is judged against: the MPM that taught the model, and how far that itself depends on its cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.data.places import check_frames
from gns_pl.errors import InputError
from gns_pl.generation import chosen_every, is_imported, reference_trajectory, thin_trajectory
from gns_pl.io import MANIFEST_NAME, read_manifest, read_trajectory
from gns_pl.metrics.measures import particle_spacing, sinkhorn_distance
from gns_pl.metrics.summary import Measured, profile_l1, summarise
from gns_pl.models.checkpoint import Checkpoint
from gns_pl.scene import Scene
from gns_pl.scene.extent import compression_notice
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.text import command, override
from gns_pl.trajectory import Trajectory

STARTS = ("scene", "frames")
"""What a rollout may start from: the scene alone, or as many true frames as one step of the simulator needs."""


@dataclass(frozen=True)
class Reference:
    """A run of the material point method.

    Attributes:
        trajectory: the particles that the simulator gets, frames at its time step.
        whole: all points of the run, or of those that are stored. Every number of the reference is measured on these;
            the front of every k-th point is not that of all.
        complete: `whole` holds all points of the run.
        starts: where the rollouts of other placements start from.
        spread: name of a summary's or comparison's entry → largest change of it on other cells, in its unit; what MPM
            itself leaves open. Empty if no other cells were run.
        cells: of the other runs, over those of this one.
    """

    trajectory: Trajectory
    whole: Measured
    complete: bool = True
    starts: tuple[Trajectory, ...] = ()
    spread: dict[str, float] = field(default_factory=dict)
    cells: tuple[float, ...] = ()


def reference_of(
    scene: Scene,
    checkpoint: Checkpoint,
    *,
    cache: Path,
    seed: int,
    cells: Sequence[float] = (),
    placements: int = 0,
    given: int = 1,
) -> Reference:
    """Run a scene by the MPM of a checkpoint's data, or find it in the cache.

    A simulator that was trained on every k-th point of fine simulations starts from every k-th point of a fine one,
    and is judged by what all points of that do.

    Args:
        scene: what to run.
        checkpoint: simulator and the specification of its data, whose MPM settings are taken.
        cache: folder of references.
        seed: of the particles' placement, and of the first of `placements`.
        cells: other sizes of cells for `Reference.spread`, over the one of the data.
        placements: number of `Reference.starts`.
        given: frames of each of these; more than one are of the material point method.

    Raises:
        InputError: a size that is not positive.
    """
    if any(not size > 0 for size in cells):
        raise InputError(f"evaluation.spread: sizes of cells over those of the data must be positive, not {cells}.")
    notice = compression_notice(scene)
    if notice is not None:
        print(f"{notice}.", flush=True)
    interval, mpm = checkpoint.simulator.config.dt, checkpoint.data["mpm"]

    def solved(wanted: Scene, seed: int, size: float = 1.0) -> Trajectory:
        settings = {**mpm, "cell_size": mpm["cell_size"] * size}
        return reference_trajectory(wanted, mpm=settings, frame_interval=interval, seed=seed, cache_directory=cache)

    def thinned(whole: Trajectory, seed: int) -> Trajectory:
        every = chosen_every(checkpoint.data)
        # Of the lattices to choose from, the one that stands least to one side.
        return thin_trajectory(whole, mpm, seed, every, [(every - 1) // 2] * scene.dim)

    whole = Measured(solved(scene, seed))
    others = [solved(scene, seed, size) for size in cells]
    stored, seeds = thinned(whole.trajectory, seed), range(seed, seed + placements)
    if given > 1:
        brief = scene.replace(duration=(given - 1) * interval)
        starts = [replace(thinned(solved(brief, number), number), scene=scene) for number in seeds]
    else:
        starts = [LearnedSolver.of(checkpoint).start(scene, number) for number in seeds]
    spread = resolution_spread(whole, others, particle_spacing(stored))
    return Reference(stored, whole, True, tuple(starts), spread, tuple(cells))


def resolution_spread(reference: Measured, others: Sequence[Trajectory], spacing: float) -> dict[str, float]:
    """Return the largest change of every number that does not follow single particles, in its unit.

    Args:
        reference: one run.
        others: the same scene on other cells; none gives nothing.
        spacing: in which the transport distance is told [m].
    """
    if not others:
        return {}
    truth, last = reference.summary, reference.trajectory.position[-1].astype(np.float64)
    spread = dict.fromkeys([*truth, "profile_l1", "sinkhorn"], 0.0)
    for other in others:
        changes = {name: abs(value - truth[name]) for name, value in summarise(other).items()}
        changes["profile_l1"] = profile_l1(other, reference.trajectory)
        moved = sinkhorn_distance(other.position[-1].astype(np.float64), last)
        changes["sinkhorn"] = moved / spacing
        spread = {name: max(value, changes[name]) for name, value in spread.items()}
    return {name: value for name, value in spread.items() if math.isfinite(value)}


def stored_references(
    checkpoint: Checkpoint, split: str, *, placements: int = 0, seed: int = 0
) -> dict[str, Reference]:
    """Return the trajectories of a split of the checkpoint's data set, name → reference, frames at its time step.

    Args:
        checkpoint: with the specification of its data.
        split: "train", "valid" or "test".
        placements: number of `Reference.starts`; imported data have none, since their bodies may have any shape.
        seed: of the first of them.

    Raises:
        InputError: an unknown split, data that are not there, or particles outside their boxes.
    """
    data: Mapping[str, Any] = checkpoint.data
    folder, every = stored_folder(data), chosen_every(data)
    manifest = read_manifest(folder)
    if split not in manifest.splits:
        raise InputError(f"evaluation.split must be one of {', '.join(manifest.splits)}, not {split!r}.")
    stride = round(checkpoint.simulator.config.dt / manifest.dt)
    references = {}
    for name in manifest.splits[split]:
        stored = read_trajectory(folder / name).every(stride)
        check_frames(str(folder / name), stored.position, stored.particle_type, stored.scene, manifest.spacing)
        seeds = range(seed, seed + placements if "mpm" in data else seed)
        starts = tuple(LearnedSolver.of(checkpoint).start(stored.scene, number) for number in seeds)
        references[Path(name).stem] = Reference(stored, Measured(stored), every == 1, starts)
    return references


def stored_folder(data: Mapping[str, Any]) -> Path:
    """Return the folder in which a checkpoint's data set lies: its "root", or that of the lattice it was trained on.

    Raises:
        InputError: it is not there, or the checkpoint does not say where it is.
    """
    if not data.get("root"):
        raise InputError(
            "evaluation.split: this checkpoint does not say where its data are; say so with data.root=FOLDER, or name "
            "scenes instead."
        )
    root = Path(data["root"])
    for folder in (root, root / f"every_{chosen_every(data)}"):
        if (folder / MANIFEST_NAME).is_file():
            return folder
    name = override("data", data["name"])
    hint = "convert them again" if is_imported(data) else f"make them: {command('generate')} {name}"
    raise InputError(f"evaluation.split: {root} holds no data; say where they are with data.root=FOLDER, or {hint}")
