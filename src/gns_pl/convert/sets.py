"""A foreign set becomes one of ours: a file a trajectory, written frame by frame, and the manifest with statistics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.convert.facts import Facts
from gns_pl.convert.formats import ForeignSet
from gns_pl.convert.formats.ours import KIND as OURS
from gns_pl.convert.own_scenes import turned_faces
from gns_pl.convert.plan import Item
from gns_pl.convert.recordings import Assumed, si_blocks, start_of
from gns_pl.data.statistics import RunningStatistics, measure_motion
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.graph.radius import advised_radius
from gns_pl.io import (
    SPLITS,
    FileRecord,
    Manifest,
    TrajectoryHeader,
    file_sha256,
    read_header,
    read_static,
    write_manifest,
)
from gns_pl.io.manifest import MANIFEST_VERSION
from gns_pl.io.stream import TrajectoryStream
from gns_pl.metrics.observables import CELL_SPACINGS, Observer
from gns_pl.scene import FACES


def write_set(
    folder: Path,
    source: ForeignSet,
    items: Sequence[Item],
    facts: Facts,
    assumed: Assumed,
    *,
    name: str,
    on_done: Callable[[str], None],
) -> None:
    """Write a data set; a trajectory that is there already is kept.

    Args:
        folder: it goes into.
        source: the source.
        items: its recordings.
        facts: units and axes.
        assumed: what the source does not say.
        name: of the data set.
        on_done: called with the name of every recording that is done.

    Raises:
        InputError: a recording that cannot be used.
        StorageError: the disk refuses.
    """
    for item in items:
        path = folder / f"{item.name}.h5"
        if not path.is_file():
            _write(path, source, item, facts, assumed)
        on_done(item.source)
    write_manifest(folder, _manifest(folder, source, items, facts, assumed, name))


def _write(path: Path, source: ForeignSet, item: Item, facts: Facts, assumed: Assumed) -> None:
    with source.recording(item.number) as recording:
        own = facts.of(recording.stated)
        start = start_of(recording, own, assumed, source.stated, item.name)
        stream, observer = TrajectoryStream(path, start), Observer(start, CELL_SPACINGS * own.spacing)
        try:
            for block in si_blocks(recording, own):
                stream.append(block)
                observer.add(block)
            provenance: dict[str, object] = {
                "solver": f"imported from {source.kind}",
                "source": item.source,
                "notes": list(recording.notes),
            }
            if recording.provenance:
                provenance["original"] = dict(recording.provenance)
            stream.finish(provenance, observer.observables())
        finally:
            stream.close()
            stream.growing.unlink(missing_ok=True)


def _manifest(
    folder: Path, source: ForeignSet, items: Sequence[Item], facts: Facts, assumed: Assumed, name: str
) -> Manifest:
    files: dict[str, FileRecord] = {}
    types: set[int] = set()
    features: set[tuple[str, ...]] = set()
    statistics = {quantity: RunningStatistics(facts.dim) for quantity in ("velocity", "acceleration")}
    for item in items:
        path = folder / f"{item.name}.h5"
        header, static = read_header(path), read_static(path)
        if not math.isclose(header.dt, facts.dt, rel_tol=1e-9):
            raise InputError(
                f"{source.path}: frames are {facts.dt:g} s apart in some trajectories and {header.dt:g} s in "
                f"{item.source}, and a set has one time step; convert these apart, file by file, or say dt=…"
            )
        files[path.name] = FileRecord(file_sha256(path), header.num_frames, header.num_particles)
        types |= set(static["particle_type"].tolist())
        features.add(header.material_features)
        if item.split == "train":
            for quantity, seen in _measured(path, header, static).items():
                statistics[quantity].merge(seen)
    if len(features) > 1:
        raise InputError(f"{source.path}: some trajectories have material values and some have none.")
    return Manifest(
        format_version=MANIFEST_VERSION,
        name=name,
        dt=facts.dt,
        dim=facts.dim,
        spacing=facts.spacing,
        particle_types=tuple(sorted(types)),
        material_features=features.pop(),
        splits={split: tuple(f"{item.name}.h5" for item in items if item.split == split) for split in SPLITS},
        files=files,
        statistics={quantity: seen.to_dict() for quantity, seen in statistics.items()},
        seed=source.stated.metadata["seed"] if source.kind == OURS else 0,
        spec=imported_spec(source, facts, assumed, name),
    )


def _measured(path: Path, header: TrajectoryHeader, static: dict[str, Any]) -> dict[str, RunningStatistics]:
    moved = static["particle_type"] != int(ParticleType.KINEMATIC)
    return measure_motion(path, header, static["initial_velocity"], moved=moved)


def advised_radius_of(manifest: Manifest) -> float:
    """Return the connectivity radius to train with on an imported set [m]: the source's, or by the spacing.

    A radius below the spacing reaches nobody, so that it must be of other units; the source's then counts for nothing.
    """
    stated = manifest.spec["imported"]["connectivity_radius"]
    return float(stated) if stated and stated >= manifest.spacing else advised_radius(manifest.spacing)


def imported_spec(source: ForeignSet, facts: Facts, assumed: Assumed, name: str) -> dict[str, Any]:
    """Return what stands in the place of a generation's specification: where it came from, and what was made of it.

    A set of ours keeps its material and walls, and unit, axes, origin and types lead on to where it came from itself.
    """
    before: dict[str, Any] = source.stated.metadata["spec"] if source.kind == OURS else {}
    earlier: dict[str, Any] = before.get("imported", {})
    axes, radius = earlier.get("axes", range(facts.dim)), source.stated.radius
    walls = before.get("walls", {face: dict(assumed.wall) for face in FACES[facts.dim]})
    clip = source.stated.metadata.get("boundary_augment", earlier.get("boundary_augment"))
    imported = {
        "format": source.kind,
        "gns_pl": gns_pl.__version__,
        "scale": facts.scale * earlier.get("scale", 1.0),
        "axes": [axes[axis] for axis in facts.axes],
        "origin": list(facts.origin_on_map(source.stated.origin)),
        "types": {**earlier.get("types", {}), **{str(key): value for key, value in facts.types.items()}},
        "connectivity_radius": None if radius is None else radius * facts.scale,
        "notes": [*earlier.get("notes", ()), *facts.notes],
        **({} if clip is None else {"boundary_augment": clip}),
    }
    return {
        "name": name,
        "imported": {**imported, "specification": before} if before else imported,
        "gravity": 0.0 - facts.gravity[-1],
        "material": before.get("material", dict(assumed.plain(source.stated))),
        "walls": turned_faces(walls, facts.axes),
    }
