"""Which VTK files are a trajectory: listed in a .pvd with their times, or numbered in their names.

A frame may be in several files, one a rank or part (`stem-<rank>_<size>-<number>`), and several series may be one
trajectory: some programs, CB-Geo MPM among them, write a file for each thing that the points carry. Series with the
same points in the same frames belong together; one with cells beside them is the mesh and no particles.
"""

from __future__ import annotations

import functools
import hashlib
import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.convert.formats.arrays import split_of
from gns_pl.convert.formats.series import even_step, listed
from gns_pl.convert.formats.source import reading
from gns_pl.convert.formats.vtk_xml import has_cells, parse_xml, read_points
from gns_pl.errors import InputError
from gns_pl.io.regular import read_bounded

_RANKED = re.compile(r"(?P<stem>.*)-(?P<rank>\d+)_(?P<size>\d+)-(?P<number>\d+)")
_NUMBERED = re.compile(r"(?P<stem>.*?)[_.-]?(?P<number>\d+)")
MOST_LIST_BYTES = 50_000_000
UNEVEN = 1e-4
"""Share of the time between frames by which one may be off."""


@dataclass(frozen=True)
class Series:
    """The files of a trajectory.

    Attributes:
        name: for messages.
        split: "train", "valid", "test" or "".
        numbers: of the frames, rising.
        frames: number → its files, one a rank.
        dt: time between frames [s]; None if nothing says.
        attributes: series of the same points, for what these carry.
    """

    name: str
    split: str
    numbers: tuple[int, ...]
    frames: Mapping[int, tuple[Path, ...]]
    dt: float | None
    attributes: tuple[Series, ...] = ()

    @property
    def folder(self) -> Path:
        """In which the first file is."""
        return self.frames[self.numbers[0]][0].parent

    @property
    def in_parts(self) -> bool:
        """Whether a frame has several files, between which particles may move."""
        return any(len(files) > 1 for files in self.frames.values())


def find_series(files: Sequence[Path], folder: Path) -> tuple[list[Series], list[str]]:
    """Return the trajectories in .pvd lists or, where there is none, in numbered files, and sentences for the report.

    Args:
        files: .pvd lists, or files of points.
        folder: the set's.

    Raises:
        InputError: lists that cannot be used, or frames that are missing; they are named.
    """
    lists = [file for file in files if file.suffix == ".pvd"]
    listed_series = [_read_list(file, folder) for file in lists] if lists else _numbered(files, folder)
    series, notes = _joined(listed_series)
    steps = set()
    if not lists:
        steps = {even_step(one.numbers, str(one.folder / one.name)) for one in series} - {None}
    times = {one.dt for one in series if len(one.numbers) > 1}
    known = [time for time in times if time is not None]
    if len(steps) > 1 or (known and (len(known) < len(times) or max(known) > min(known) * (1 + 1e-6))):
        raise InputError(f"{folder}: its series have different intervals between frames; convert them one by one.")
    return series, notes


def read_frame(series: Series, number: int, *, attributes: bool = True) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Return the points of a frame [N, 3] in the order of its files, and what they carry.

    Args:
        series: of the frame.
        number: of the frame.
        attributes: whether the files of the attributes are read as well.
    """
    points, arrays = _read(series.frames[number])
    for other in series.attributes if attributes else ():
        if number in other.frames:
            arrays = {**_read(other.frames[number])[1], **arrays}
    return points, arrays


def _read(files: Sequence[Path]) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    points, arrays = [], []
    for file in files:
        with reading(file):
            one, more = read_points(file, empty=len(files) > 1)
        if len(one):
            points.append(one)
            arrays.append(more)
    if not points:
        raise InputError(f"{files[0]}: has no points.")
    names = set(arrays[0]).intersection(*arrays)
    return np.concatenate(points), {name: np.concatenate([part[name] for part in arrays]) for name in sorted(names)}


def _read_list(file: Path, folder: Path) -> Series:
    entries: list[tuple[float, str, Path]] = []
    with reading(file):
        for entry in parse_xml(read_bounded(file, MOST_LIST_BYTES, "a list of files")).iter("DataSet"):
            name = entry.get("file", "")
            if not name or Path(name).is_absolute() or ".." in Path(name).parts:
                raise InputError(f"lists {name!r}, which is not a file beside or below it.")
            entries.append((float(entry.get("timestep", "nan")), entry.get("part", "0"), file.parent / name))
        missing = [path.name for _, _, path in entries if not path.exists()]
        if missing:
            raise InputError(f"lists {listed(missing)}, not there; put back what is missing, or take it off the list.")
        timed = [math.isfinite(time) for time, _, _ in entries]
        if any(timed) and not all(timed):
            raise InputError(f"gives {sum(timed)} of its {len(timed)} frames a time; give it to all, or to none.")
        frames: dict[float, dict[str, Path]] = {}
        for place, (time, part, path) in enumerate(entries):
            parts = frames.setdefault(time if timed[place] else float(place), {})
            if parts.setdefault(part, path) != path:
                raise InputError(f"lists two files for the time {time:g}; a trajectory has one frame at a time.")
        if not frames:
            raise InputError("lists no files.")
        times = sorted(frames)
        return Series(
            name=file.stem,
            split=split_of(file, folder),
            numbers=tuple(range(len(times))),
            frames={place: tuple(frames[time].values()) for place, time in enumerate(times)},
            dt=_even_time(np.array(times)) if all(timed) else None,
        )


def _even_time(times: NDArray[np.float64]) -> float | None:
    """Return the time between frames [s]; None of a single one.

    Args:
        times: rising [T] [s].

    Raises:
        InputError: they do not follow evenly.
    """
    if len(times) < 2:
        return None
    steps = np.diff(times)
    dt = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - dt) > UNEVEN * dt)
    if len(uneven):
        before, after = times[uneven[0]], times[uneven[0] + 1]
        raise InputError(
            f"its frames do not follow evenly in time: after {before:.9g} s comes {after:.9g} s and not "
            f"{before + dt:.9g} s, and a trajectory has one time step; put back what is missing, or convert what is "
            "before and behind it from lists of their own."
        )
    return float(f"{(times[-1] - times[0]) / (len(times) - 1):.9g}")


def _numbered(files: Sequence[Path], folder: Path) -> list[Series]:
    frames_of: dict[tuple[Path, str], dict[int, dict[int, Path]]] = {}
    sizes: dict[tuple[Path, str], int] = {}
    for file in files:
        ranked = _RANKED.fullmatch(file.stem)
        if ranked and not int(ranked["rank"]) < int(ranked["size"]):
            ranked = None  # a name that looks like it
        match = ranked or _NUMBERED.fullmatch(file.stem)
        stem, number = (match["stem"], int(match["number"])) if match else (file.stem, 0)
        rank, size = (int(ranked["rank"]), int(ranked["size"])) if ranked else (0, 1)
        key = (file.parent, stem)
        parts = frames_of.setdefault(key, {}).setdefault(number, {})
        same = parts.setdefault(rank, file)
        if same != file or sizes.setdefault(key, size) != size:
            raise InputError(f"{file}: is of the same series and frame as {same.name}; keep one of the two.")
    series = []
    for (parent, stem), frames in sorted(frames_of.items()):
        size = sizes[parent, stem]
        for number, parts in frames.items():
            if sorted(parts) != list(range(size)):
                raise InputError(f"{parent / stem}: frame {number} lacks the files of some of its {size} ranks.")
        files_of = {number: tuple(frames[number][rank] for rank in range(size)) for number in sorted(frames)}
        split = split_of(files_of[min(files_of)][0], folder)
        series.append(Series(stem or parent.name, split, tuple(files_of), files_of, None))
    return series


def _joined(all_series: Sequence[Series]) -> tuple[list[Series], list[str]]:
    """Return the series of particles, each with those of the same points as its attributes, and sentences."""
    folders: dict[Path, list[Series]] = defaultdict(list)
    for series in all_series:
        folders[series.folder].append(series)
    joined: list[Series] = []
    notes: list[str] = []
    look = functools.cache(_look)
    for folder, beside in folders.items():
        meshes = [series for series in beside if len(beside) > 1 and _is_mesh(series)]
        if len(meshes) < len(beside):
            notes += [
                f"{series.name} in {folder} has cells: it is a mesh, no particles, and left out" for series in meshes
            ]
            beside = [series for series in beside if series not in meshes]
        hosts: list[Series] = []
        for series in sorted(beside, key=lambda one: (-len(one.numbers), one.name)):
            place = next((k for k, host in enumerate(hosts) if _belongs(series, host, look)), None)
            if place is None:
                hosts.append(series)
            else:
                hosts[place] = replace(hosts[place], attributes=(*hosts[place].attributes, series))
        for host in sorted(hosts, key=lambda one: one.name):
            if host.attributes:
                names = listed([host.name, *(series.name for series in host.attributes)])
                notes.append(f"{names} in {folder} have the same points and are one trajectory")
            joined.append(replace(host, name=folder.name) if host.attributes and len(hosts) == 1 else host)
    return joined, notes


def _is_mesh(series: Series) -> bool:
    with reading(series.frames[series.numbers[0]][0]):
        return has_cells(series.frames[series.numbers[0]][0])


def _look(files: tuple[Path, ...]) -> tuple[str, frozenset[str]]:
    """Return a digest of the points of a frame, and the names of what they carry."""
    points, arrays = _read(files)
    return hashlib.sha256(points.astype(np.float64).tobytes()).hexdigest(), frozenset(arrays)


def _belongs(series: Series, host: Series, look: Callable[[tuple[Path, ...]], tuple[str, frozenset[str]]]) -> bool:
    """Return whether a series has the points of another and carries other things; equal runs carry the same."""
    common = sorted(set(series.numbers) & set(host.numbers))
    if series.dt != host.dt or not common or (len(common) == 1 and len(series.numbers) > 1):
        return False
    names = look(series.frames[common[0]])[1]
    taken = [look(one.frames[one.numbers[0]])[1] for one in (host, *host.attributes)]
    if names & frozenset().union(*taken):
        return False
    places = {common[0], common[len(common) // 2], common[-1]}
    return all(look(series.frames[place])[0] == look(host.frames[place])[0] for place in places)
