"""Sets in others' formats: geoelements/gns, LagrangeBench, and VTK series, from whatever could be read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.common import Common
from gns_pl.convert.facts import Facts
from gns_pl.convert.formats import ForeignSet, Recording
from gns_pl.convert.formats.geoelements import npz_writer
from gns_pl.convert.formats.lagrangebench import THEIRS, groups_writer
from gns_pl.convert.formats.metadata import PART_OF_SPLIT
from gns_pl.convert.formats.source import reading
from gns_pl.convert.material_value import METADATA_KEY
from gns_pl.convert.plan import Item
from gns_pl.convert.recordings import Assumed, si_blocks, start_of, whole_trajectory
from gns_pl.data.statistics import RunningStatistics
from gns_pl.fields import ParticleType
from gns_pl.graph.radius import advised_radius
from gns_pl.io import SPLITS
from gns_pl.io.atomic import write_atomically
from gns_pl.trajectory import Trajectory

Blocks: TypeAlias = Iterator[NDArray[np.float32]]
"""All frames of a recording, block by block [n, N, D] [m]."""
TYPE_SIZE = 16
"""Numbers in which networks of geoelements/gns code a particle's type."""
VELOCITIES = 5
"""That they see."""


@dataclass
class FrameStatistics:
    """Displacements between frames, and their changes, of the moved particles of a split, seen block by block.

    Attributes:
        dim: D.
        split: "train", or the first that there is.
    """

    dim: int
    split: str

    def __post_init__(self) -> None:
        self.velocity, self.acceleration = RunningStatistics(self.dim), RunningStatistics(self.dim)

    def passed(self, blocks: Blocks, item: Item, moved: NDArray[np.bool_]) -> Blocks:
        """Yield the blocks of a trajectory again, having looked at them."""
        before = np.empty((0, int(moved.sum()), self.dim))
        for block in blocks:
            yield block
            if item.split == self.split:
                kept = np.concatenate([before, block[:, moved].astype(np.float64)])
                step = np.diff(kept, axis=0)
                self.velocity.update(step[max(0, len(before) - 1) :].reshape(-1, self.dim))
                self.acceleration.update(np.diff(step, axis=0).reshape(-1, self.dim))
                before = kept[-2:]

    def metadata(self, found: ForeignSet, facts: Facts) -> dict[str, Any]:
        """Return what geoelements/gns and LagrangeBench are told of the whole set, in metres and frames."""
        radius = found.stated.radius
        return {
            "default_connectivity_radius": advised_radius(facts.spacing) if radius is None else radius * facts.scale,
            "dim": facts.dim,
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
        common: what the format says once for all of them.
        told: called with the name of every recording that is done.
    """

    folder: Path
    found: ForeignSet
    items: Sequence[Item]
    facts: Facts
    assumed: Assumed
    common: Common
    told: Callable[[str], None]

    def opened(self, split: str) -> Iterator[tuple[int, Item, Recording, Trajectory, Blocks]]:
        """Yield number in the split, item, open recording, first frame and all frames of every recording of a split.

        Raises:
            InputError: a recording that cannot be used, or that `common` refuses; it is named.
        """
        for number, item in enumerate(each for each in self.items if each.split == split):
            with self.found.recording(item.number) as recording:
                own = self.facts.of(recording.stated)
                start = start_of(recording, own, self.assumed, self.found.stated, item.name)
                if self.common.part_of:
                    self.common.see(
                        split,
                        start.scene,
                        num_frames=recording.num_frames,
                        num_particles=recording.num_particles,
                        dt=start.dt,
                        num_features=len(start.material_features),
                    )
                blocks = named(f"{self.found.path}, {item.source}", si_blocks(recording, own))
                yield number, item, recording, start, blocks
            self.told(item.source)


def write_geoelements(export: Export) -> None:
    """Write train.npz, valid.npz, test.npz as geoelements/gns has them, and metadata.json.

    Raises:
        InputError: more than one material feature, one that some trajectories lack, several boxes or time steps in a
            part of the metadata, obstacles, or a recording that cannot be used.
    """
    seen, common = FrameStatistics(export.facts.dim, _splits(export.items)[0]), export.common
    feature = None
    for split in _splits(export.items):
        with npz_writer(export.folder / f"{split}.npz") as add:
            for number, item, recording, start, blocks in export.opened(split):
                looked = seen.passed(blocks, item, _moved(start))
                whole = whole_trajectory(start, recording.num_frames, looked)
                arrays: dict[str, NDArray[Any]] = {"position": whole.position, "particle_type": start.particle_type}
                if start.material_features:
                    feature = start.material_features[0]
                    arrays["material"] = start.material[:, 0]
                add(f"simulation_trajectory_{number}", arrays)
    dim, metadata = export.facts.dim, seen.metadata(export.found, export.facts)
    stated = export.found.stated.metadata
    clip = stated.get("boundary_augment", stated.get("spec", {}).get("imported", {}).get("boundary_augment"))
    if clip is not None:
        metadata["boundary_augment"] = clip
    if common.num_features:  # their program knows the widths without a material value by itself
        metadata[METADATA_KEY] = feature
        metadata |= {"nnode_in": (VELOCITIES + 2) * dim + TYPE_SIZE + 1, "nedge_in": dim + 1}
    _write_metadata(export.folder, with_parts(metadata, common.said()))


def write_lagrangebench(export: Export) -> None:
    """Write train.h5, valid.h5, test.h5 as LagrangeBench has them, and metadata.json; material values have no place.

    Raises:
        InputError: several boxes, time steps or lengths, obstacles, or a recording that cannot be used.
    """
    seen, common = FrameStatistics(export.facts.dim, _splits(export.items)[0]), export.common
    for split in _splits(export.items):
        with groups_writer(export.folder / f"{split}.h5") as add:
            for number, item, recording, start, blocks in export.opened(split):
                kinds = set(start.particle_type.tolist()) - set(THEIRS)
                common.note(start.scene, friction=np.unique(start.material).tolist(), particle_types=sorted(kinds))
                add(number, recording.num_frames, start.particle_type, seen.passed(blocks, item, _moved(start)))
    lengths = common.frames
    more = {
        "dx": export.facts.spacing,
        "write_every": 1,
        "num_particles_max": common.num_particles,
        "periodic_boundary_conditions": [False] * export.facts.dim,
        "sequence_length_train": min(lengths["train"], default=0),
        "sequence_length_test": min(lengths["test"], default=0),
        "num_trajs_train": len(lengths["train"]),
        "num_trajs_test": len(lengths["test"]),
    }
    _write_metadata(export.folder, {**seen.metadata(export.found, export.facts), **common.said(), **more})


def write_vtk(export: Export) -> None:
    """Write a .pvd list and a .vtp file a frame of every trajectory, into folders by split.

    Raises:
        InputError: a recording that cannot be used.
    """
    from gns_pl.viz import write_paraview

    for split in _splits(export.items):
        for _, item, recording, start, blocks in export.opened(split):
            box, obstacles = (start.scene.lower, start.scene.upper, start.scene.origin), start.scene.obstacles
            export.common.note(start.scene, boxes=[box], obstacles=[None, *obstacles])
            whole = whole_trajectory(start, recording.num_frames, blocks)
            write_paraview(export.folder / split, whole, name=item.name)


WRITERS: dict[str, tuple[Callable[[Export], None], Callable[[], Common]]] = {
    "geoelements": (write_geoelements, lambda: Common("geoelements/gns", PART_OF_SPLIT, most_features=1)),
    "lagrangebench": (
        write_lagrangebench,
        lambda: Common("LagrangeBench", dict.fromkeys(SPLITS, "all"), equal_lengths=True),
    ),
    "vtk": (write_vtk, lambda: Common("a VTK series", {})),
}
"""Format → what writes it, and what it says once for all trajectories."""


def named(source: str, blocks: Blocks) -> Blocks:
    """Yield blocks again; a frame that cannot be used is told with the name of its recording."""
    with reading(source):
        yield from blocks


def with_parts(metadata: Mapping[str, Any], said: Mapping[str, Any]) -> dict[str, Any]:
    """Return metadata of all trajectories with what is said of them, or of each part of them (`Common.said`)."""
    if "bounds" in said:
        return {**said, **metadata}
    return {part: {**of_part, **metadata} for part, of_part in said.items()}


def _splits(items: Sequence[Item]) -> list[str]:
    return [split for split in SPLITS if any(item.split == split for item in items)]


def _moved(start: Trajectory) -> NDArray[np.bool_]:
    return np.asarray(start.particle_type != int(ParticleType.KINEMATIC))


def _write_metadata(folder: Path, content: dict[str, Any]) -> None:
    write_atomically(folder / "metadata.json", (json.dumps(content, indent=1) + "\n").encode())
