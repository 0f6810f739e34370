"""Sets in others' formats: geoelements/gns, LagrangeBench, and VTK series, from whatever could be read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.conversion.facts import Facts
from gns_pl.conversion.material_value import METADATA_KEY
from gns_pl.conversion.plan import Item
from gns_pl.conversion.recordings import Assumed, si_blocks, start_of, whole_trajectory
from gns_pl.data.statistics import RunningStatistics
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io import SPLITS
from gns_pl.io.atomic import write_atomically
from gns_pl.io.convert import ForeignSet, Recording
from gns_pl.io.convert.geoelements import npz_writer
from gns_pl.io.convert.lagrangebench import groups_writer
from gns_pl.trajectory import Trajectory

RADIUS = 2.0
"""Connectivity radius where the source has none, in spacings."""


@dataclass
class FrameStatistics:
    """Displacements between frames, and their changes, of the training split's moved particles, seen block by block.

    Attributes:
        dim: D.
        frames: T of every trajectory, by split.
    """

    dim: int
    frames: dict[str, list[int]] = field(default_factory=lambda: {split: [] for split in SPLITS})

    def __post_init__(self) -> None:
        self.velocity, self.acceleration = RunningStatistics(self.dim), RunningStatistics(self.dim)

    def passed(
        self, blocks: Iterator[NDArray[np.float32]], item: Item, recording: Recording, moved: NDArray[np.bool_]
    ) -> Iterator[NDArray[np.float32]]:
        """Yield the blocks of a trajectory again, having looked at them."""
        self.frames[item.split].append(recording.num_frames)
        before = np.empty((0, int(moved.sum()), self.dim))
        for block in blocks:
            yield block
            if item.split == "train":
                kept = np.concatenate([before, block[:, moved].astype(np.float64)])
                step = np.diff(kept, axis=0)
                self.velocity.update(step[max(0, len(before) - 1) :].reshape(-1, self.dim))
                self.acceleration.update(np.diff(step, axis=0).reshape(-1, self.dim))
                before = kept[-2:]

    def metadata(self, found: ForeignSet, facts: Facts) -> dict[str, Any]:
        """Return the keys that geoelements/gns and LagrangeBench share, in metres and frames."""
        radius = found.stated.radius
        return {
            "bounds": [list(pair) for pair in zip(facts.lower, facts.upper, strict=True)],
            "sequence_length": min(length for lengths in self.frames.values() for length in lengths),
            "default_connectivity_radius": RADIUS * facts.spacing if radius is None else radius * facts.scale,
            "dim": facts.dim,
            "dt": facts.dt,
            "vel_mean": self.velocity.mean.tolist(),
            "vel_std": self.velocity.std.tolist(),
            "acc_mean": self.acceleration.mean.tolist(),
            "acc_std": self.acceleration.std.tolist(),
        }


@dataclass(frozen=True)
class Export:
    """What is written where.

    Attributes:
        folder: it goes into.
        found: the source.
        items: its recordings.
        facts: units and axes.
        assumed: what the source does not say.
        told: called with the name of every recording that is done.
    """

    folder: Path
    found: ForeignSet
    items: Sequence[Item]
    facts: Facts
    assumed: Assumed
    told: Callable[[str], None]

    def opened(self, split: str) -> Iterator[tuple[int, Item, Recording, Trajectory]]:
        """Yield number in the split, item, open recording and first frame of every recording of a split."""
        for number, item in enumerate(each for each in self.items if each.split == split):
            with self.found.recording(item.number) as recording:
                yield (
                    number,
                    item,
                    recording,
                    start_of(recording, self.facts, self.assumed, self.found.stated, item.name),
                )
            self.told(item.source)


def write_geoelements(export: Export) -> None:
    """Write train.npz, valid.npz, test.npz as geoelements/gns has them, and metadata.json.

    Raises:
        InputError: more than one material feature, or a recording that cannot be used.
    """
    seen, feature = FrameStatistics(export.facts.dim), None
    for split in _splits(export.items):
        with npz_writer(export.folder / f"{split}.npz") as add:
            for number, item, recording, start in export.opened(split):
                if len(start.material_features) > 1:
                    raise InputError(f"geoelements/gns has room for one material value, not {start.material_features}.")
                blocks = seen.passed(si_blocks(recording, export.facts), item, recording, _moved(start))
                whole = whole_trajectory(start, recording.num_frames, blocks)
                arrays: dict[str, NDArray[Any]] = {"position": whole.position, "particle_type": start.particle_type}
                if start.material_features:
                    feature = start.material_features[0]
                    arrays["material"] = start.material[:, 0]
                add(f"simulation_trajectory_{number}", arrays)
    content = seen.metadata(export.found, export.facts)
    _write_metadata(export.folder, content if feature is None else {**content, METADATA_KEY: feature})


def write_lagrangebench(export: Export) -> None:
    """Write train.h5, valid.h5, test.h5 as LagrangeBench has them, and metadata.json; material values have no place.

    Raises:
        InputError: a recording that cannot be used.
    """
    seen = FrameStatistics(export.facts.dim)
    for split in _splits(export.items):
        with groups_writer(export.folder / f"{split}.h5") as add:
            for number, item, recording, start in export.opened(split):
                blocks = seen.passed(si_blocks(recording, export.facts), item, recording, _moved(start))
                add(number, recording.num_frames, start.particle_type, blocks)
    lengths = seen.frames
    more = {
        "dx": export.facts.spacing,
        "write_every": 1,
        "periodic_boundary_conditions": [False] * export.facts.dim,
        "sequence_length_train": min(lengths["train"], default=0),
        "sequence_length_test": min(lengths["test"], default=0),
        "num_trajs_train": len(lengths["train"]),
        "num_trajs_test": len(lengths["test"]),
    }
    _write_metadata(export.folder, {**seen.metadata(export.found, export.facts), **more})


def write_vtk(export: Export) -> None:
    """Write a .pvd list and a .vtp file a frame of every trajectory, into folders by split.

    Raises:
        InputError: a recording that cannot be used.
    """
    from gns_pl.viz import write_paraview

    for split in _splits(export.items):
        for _, item, recording, start in export.opened(split):
            blocks = si_blocks(recording, export.facts)
            whole = whole_trajectory(start, recording.num_frames, blocks)
            write_paraview(export.folder / split, whole, name=item.name)


def _splits(items: Sequence[Item]) -> list[str]:
    return [split for split in SPLITS if any(item.split == split for item in items)]


def _moved(start: Trajectory) -> NDArray[np.bool_]:
    return np.asarray(start.particle_type != int(ParticleType.KINEMATIC))


def _write_metadata(folder: Path, content: dict[str, Any]) -> None:
    write_atomically(folder / "metadata.json", (json.dumps(content, indent=1) + "\n").encode())
