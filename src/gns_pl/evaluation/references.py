"""What a rollout is judged against: the MPM that taught the model, and how far that itself depends on its cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.checkpoint import Checkpoint
from gns_pl.data.places import check_frames
from gns_pl.errors import InputError
from gns_pl.evaluation.measures import particle_spacing, sinkhorn_distance
from gns_pl.evaluation.metrics import profile_l1, summarise
from gns_pl.generation import DatasetSpec, chosen_every, is_imported, reference_trajectory, thin_trajectory
from gns_pl.generation.records import stored_folders
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class Reference:
    """A run of the material point method.

    Attributes:
        trajectory: the particles that the simulator gets, frames at its time step.
        spread: name of a summary's or comparison's entry → largest change of it on other cells, in its unit; what MPM
            itself leaves open. Empty if no other cells were run.
        cells: of the other runs, over those of this one.
    """

    trajectory: Trajectory
    spread: dict[str, float] = field(default_factory=dict)
    cells: tuple[float, ...] = ()


def reference_of(
    scene: Scene, checkpoint: Checkpoint, *, cache: Path, seed: int, cells: Sequence[float] = ()
) -> Reference:
    """Run a scene by the MPM of a checkpoint's data, or find it in the cache.

    A simulator that was trained on every k-th point of fine simulations is judged on every k-th point of a fine one.

    Args:
        scene: what to run.
        checkpoint: simulator and the specification of its data, whose MPM settings are taken.
        cache: folder of references.
        seed: of the particles' placement.
        cells: other sizes of cells for `Reference.spread`, over the one of the data.

    Raises:
        InputError: a size that is not positive.
    """
    if any(not size > 0 for size in cells):
        raise InputError(f"evaluation.spread: sizes of cells over those of the data must be positive, not {cells}.")
    interval, mpm = checkpoint.simulator.config.dt, checkpoint.data["mpm"]
    whole = reference_trajectory(scene, mpm=mpm, frame_interval=interval, seed=seed, cache_directory=cache)
    others = [
        reference_trajectory(
            scene,
            mpm={**mpm, "cell_size": mpm["cell_size"] * size},
            frame_interval=interval,
            seed=seed,
            cache_directory=cache,
        )
        for size in cells
    ]
    every = chosen_every(checkpoint.data)
    middle = [(every - 1) // 2] * scene.dim  # of the lattices to choose from, the one that stands least to one side
    thinned = thin_trajectory(whole, mpm, seed, every, middle)
    return Reference(thinned, resolution_spread(whole, others, particle_spacing(thinned)), tuple(cells))


def resolution_spread(reference: Trajectory, others: Sequence[Trajectory], spacing: float) -> dict[str, float]:
    """Return the largest change of every number that does not follow single particles, in its unit.

    Args:
        reference: one run.
        others: the same scene on other cells; none gives nothing.
        spacing: in which the transport distance is told [m].
    """
    if not others:
        return {}
    truth, last = summarise(reference), reference.position[-1].astype(np.float64)
    spread = dict.fromkeys([*truth, "profile_l1", "sinkhorn"], 0.0)
    for other in others:
        changes = {name: abs(value - truth[name]) for name, value in summarise(other).items()}
        changes["profile_l1"] = profile_l1(other, reference)
        moved = sinkhorn_distance(other.position[-1].astype(np.float64), last)
        changes["sinkhorn"] = moved / spacing
        spread = {name: max(value, changes[name]) for name, value in spread.items()}
    return {name: value for name, value in spread.items() if math.isfinite(value)}


def stored_references(checkpoint: Checkpoint, split: str) -> dict[str, Reference]:
    """Return the trajectories of a split of the checkpoint's data set, name → reference, frames at its time step.

    Args:
        checkpoint: with the specification of its data.
        split: "train", "valid" or "test".

    Raises:
        InputError: an unknown split, data that are not there, or particles outside their boxes.
    """
    data: Mapping[str, Any] = checkpoint.data
    if "root" not in data:
        raise InputError("evaluation.split: this checkpoint does not say where its data are; name scenes instead.")
    imported = is_imported(data)
    folder = Path(data["root"])
    if not imported:
        folder = stored_folders(folder, DatasetSpec.from_dict(data))[chosen_every(data)]
    if not (folder / "manifest.json").is_file():
        hint = "convert them again" if imported else f"make them: python generate.py data={data['name']}"
        raise InputError(f"evaluation.split: {folder} holds no data; {hint}")
    manifest = read_manifest(folder)
    if split not in manifest.splits:
        raise InputError(f"evaluation.split must be one of {', '.join(manifest.splits)}, not {split!r}.")
    stride = round(checkpoint.simulator.config.dt / manifest.dt)
    names = manifest.splits[split]
    references = {}
    for name in names:
        trajectory = read_trajectory(folder / name).every(stride)
        place = str(folder / name)
        check_frames(place, trajectory.position, trajectory.particle_type, trajectory.scene, manifest.spacing)
        references[Path(name).stem] = Reference(trajectory)
    return references
