"""The tables of a chart: what was measured, a row each, on the disk as soon as it is known.

A row says what it measured (its key) and what came of it. A killed run finds its rows again by their keys, so nothing
is measured twice, and what another checkpoint, solver, machine or number of threads gave is never taken for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from gns_pl.io.tables import read_table, write_table


@dataclass(frozen=True)
class Environment:
    """Where something was measured.

    Attributes:
        machine: processor and cores, or the GPU with them.
        device: "cpu" or "cuda".
        threads: that a run may use.
        versions: of packages.
        session: when the process that measured began; times of one session were taken in turns.
    """

    machine: str
    device: str
    threads: int
    versions: str
    session: str


@dataclass(frozen=True)
class RunRow:
    """One run: one setting, one scene, one placement.

    Attributes:
        name: of the setting.
        group: "mpm", "learned", "corrected", "hybrid" or "trivial".
        identity: hash of all that decides the run: settings and solver, or the checkpoint's file.
        kind: of the scene, "plane", "space" or "terrain".
        scene: its name.
        judged: hash of scene, frames and reference.
        placement: seed of the particles' places.
        machine: as `Environment`, like the next two.
        device: likewise.
        threads: likewise.
        dim: of what was run.
        dtype: of its arithmetic.
        particles: of what was run.
        steps: likewise.
        work: what the time is proportional to (`Solver.cost`).
        front: final advance of the front (`metrics.release.front_advance`) [m]; NaN if the run failed.
        front_error: of it, relative, signed; of a column that of the 99 % runout. Infinite if the run failed, as the
            next five.
        map_error: share of the final volume in the wrong place (`metrics.maps.map_error`).
        height_error: of the final mean height, relative, signed.
        arrest_error: of the time after which the flow is over, relative, signed.
        curve_error: mean absolute difference of the front over time, over its final value.
        profile_error: area between the final profiles of the surface over the deposit's.
        seconds: wall time of the run, warm.
        cpu_seconds: processor time of all its threads, which another process disturbs less.
        first_seconds: of the untimed run before, what is compiled in it included.
        file_seconds: for writing its frames to a file.
        versions: as `Environment`.
        session: likewise.
    """

    KEY: ClassVar = ("name", "identity", "scene", "judged", "placement", "machine", "device", "threads")

    name: str
    group: str
    identity: str
    kind: str
    scene: str
    judged: str
    placement: int
    machine: str
    device: str
    threads: int
    dim: int
    dtype: str
    particles: int
    steps: int
    work: float
    front: float
    front_error: float
    map_error: float
    height_error: float
    arrest_error: float
    curve_error: float
    profile_error: float
    seconds: float
    cpu_seconds: float
    first_seconds: float
    file_seconds: float
    versions: str
    session: str


@dataclass(frozen=True)
class RatioRow:
    """Two settings run in turns in one process, all scenes once each a turn.

    Attributes:
        name: of the learned one.
        identity: its hash.
        other: name of the solver's.
        other_identity: its hash.
        judged: hash of all scenes.
        machine: as `Environment`, like the next one.
        threads: likewise.
        seconds: median wall time a scene [s].
        other_seconds: the same of the other.
        ratio: median over the turns of the other's time over this one's.
        turns: number of them.
    """

    KEY: ClassVar = ("name", "identity", "other", "other_identity", "judged", "machine", "threads")

    name: str
    identity: str
    other: str
    other_identity: str
    judged: str
    machine: str
    threads: int
    seconds: float
    other_seconds: float
    ratio: float
    turns: int


@dataclass(frozen=True)
class BatchRow:
    """Many scenes at once.

    Attributes:
        name: of the setting.
        group: as of a run.
        identity: likewise.
        judged: hash of the scenes.
        batch: number of scenes.
        machine: as `Environment`, like the next two.
        device: likewise.
        threads: likewise.
        how: in which way they ran at once.
        seconds: median wall time of all.
        scenes_per_second: batch over seconds.
        turns: timed.
        versions: as `Environment`.
    """

    KEY: ClassVar = ("name", "identity", "judged", "batch", "machine", "device", "threads")

    name: str
    group: str
    identity: str
    judged: str
    batch: int
    machine: str
    device: str
    threads: int
    how: str
    seconds: float
    scenes_per_second: float
    turns: int
    versions: str


R = TypeVar("R", RunRow, RatioRow, BatchRow)


def key_of(row: RunRow | RatioRow | BatchRow) -> tuple[Any, ...]:
    """Return by what a row is found again."""
    return tuple(getattr(row, name) for name in row.KEY)


class Table(Generic[R]):
    """Rows of one kind in a CSV file.

    Args:
        path: the file; read if it is there.
        kind: of its rows.

    Raises:
        InputError: a file that holds something else.
    """

    def __init__(self, path: Path, kind: type[R]) -> None:
        self.path = path
        self._kind: type[R] = kind
        self._rows: dict[tuple[Any, ...], R] = {}
        if path.exists():
            rows = read_table(path, kind, "is no table of benchmark.py; move it away or choose another out=")
            self._rows = {key_of(row): row for row in rows}

    def __iter__(self) -> Iterator[R]:
        return iter(self._rows.values())

    def __len__(self) -> int:
        return len(self._rows)

    def find(self, **key: Any) -> R | None:
        """Return the row of a key, None if there is none."""
        return self._rows.get(tuple(key[name] for name in self._kind.KEY))

    def replace(self, rows: Iterable[R], digits: int) -> None:
        """Write rows in the place of all that there are, with so many significant digits; without rows, no file.

        Raises:
            StorageError: the disk refuses; the file is as it was.
        """
        self._rows = {key_of(row): row for row in rows}
        if self._rows:
            write_table(self.path, self._kind, self._rows.values(), digits)
        else:
            self.path.unlink(missing_ok=True)

    def add(self, *rows: R) -> None:
        """Add rows, or put them in the place of those of their keys; the file holds them when this returns.

        Raises:
            StorageError: the disk refuses; the file is as it was.
        """
        self._rows |= {key_of(row): row for row in rows}
        write_table(self.path, self._kind, self._rows.values())


class Tables:
    """The tables of a chart's folder.

    Args:
        folder: where they are, or will be.

    Raises:
        InputError: files of these names that hold something else.
    """

    def __init__(self, folder: Path) -> None:
        self.runs = Table(folder / "runs.csv", RunRow)
        self.ratios = Table(folder / "ratios.csv", RatioRow)
        self.batches = Table(folder / "batches.csv", BatchRow)
