"""One run in its file: frames are written as they are made, and a run that was broken off goes on from them.

Solvers whose state is more than frames save it beside the file now and then; `STATE` is the ending of its name.
"""

from __future__ import annotations

import io
import math
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.io import read_header, read_window, write_trajectory
from gns_pl.io.atomic import write_atomically
from gns_pl.io.stream import TrajectoryStream, find_frames, go_on
from gns_pl.rollout.progress import counting
from gns_pl.scene import Scene
from gns_pl.solvers.reduction import Reduction
from gns_pl.trajectory import Trajectory

STATE = ".state.npz"

SAVE_EVERY = 30.0
"""Seconds of computing between two saved states: what a killed run loses at most."""

REFUSED = (
    "is of another scene, solver or checkpoint, settings, frame interval, seed or version; remove it or choose another "
    "out=."
)


@dataclass
class Recording:
    """The file of a run, and how far it is.

    Attributes:
        path: the file.
        start: first frame, as the solver runs it.
        reduction: from the scene of the file to the one that is run.
        num_steps: frames that are still to be added.
        made: number of the last frame there is.
        past: the last frames there are, as the solver runs them [K, N, D] [m]; None if there is none but the first.
        source: file that holds the frames made before; None if there are none.
        ended: why and when an earlier run of it ended before its time, in words; empty if it did not.
        saved: state of the solver at frame `made`; None if none was saved.
    """

    path: Path
    start: Trajectory
    reduction: Reduction
    num_steps: int
    made: int = 0
    past: NDArray[np.float32] | None = None
    source: Path | None = None
    ended: str = ""
    saved: dict[str, NDArray[Any]] | None = None
    _stream: TrajectoryStream | None = field(default=None, repr=False)
    _began: float = field(default_factory=time.perf_counter, repr=False)
    _saved_at: float = field(default_factory=time.perf_counter, repr=False)

    @classmethod
    def of(
        cls,
        path: Path,
        start: Trajectory,
        reduction: Reduction,
        num_steps: int,
        *,
        history: int = 1,
        stateful: bool = False,
    ) -> Recording:
        """Return what is to do for a scene, after a look at what is there.

        Args:
            path: the file.
            start: first frame of what is run, its `dt` that of all frames; its provenance tells runs apart.
            reduction: from the scene of the file to that of `start`.
            num_steps: frames to be added to the first.
            history: frames that a step needs.
            stateful: frames are not enough to go on from; a state was saved beside them.

        Raises:
            InputError: the file is of another run.
        """
        whole = reduction.lift(start)
        found = find_frames(path)
        if found is None:
            return cls(path, start, reduction, num_steps)
        source, header = found
        same = (
            all(header.provenance.get(key, value) == value for key, value in start.provenance.items())
            and header.scene.replace(duration=whole.scene.duration) == whole.scene
            and math.isclose(header.dt, whole.dt, rel_tol=1e-6)
            and header.num_particles == whole.num_particles
            and np.array_equal(read_window(source, 0, 1), whole.position)
        )
        if not same:
            raise InputError(f"{source}: {REFUSED}")
        made, saved = header.num_frames - 1, None
        failed_at, rested = (header.provenance.get(key) for key in ("failed_at", "at_rest_from"))
        ended = f"until it failed at {failed_at:g} s" if isinstance(failed_at, float) else ""
        if isinstance(rested, float) and made < math.ceil(header.scene.duration / header.dt - 1e-6):
            ended = f"until it came to rest at {rested:g} s"
        left = 0 if ended else max(0, num_steps - made)
        if stateful and (left or source != path):
            saved = _read_state(path)
            made = -1 if saved is None else min(made, int(saved["frame"]))
            if saved is None or made != int(saved["frame"]):
                return cls(path, start, reduction, num_steps)
            left = num_steps - made
        first = max(0, made + 1 - history)
        past = reduction.project(read_window(source, first, made + 1 - first))
        return cls(path, start, reduction, left, made, past, source, ended, saved)

    @property
    def interval(self) -> float:
        """Time between the frames of the file [s]."""
        return self.start.dt * self.reduction.similarity.time

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to do: the file has all its frames and its name."""
        return self.num_steps == 0 and self.source == self.path

    def open(self) -> None:
        """Begin to write; the frames that there are stay.

        Raises:
            StorageError: the disk refuses.
        """
        start = self.reduction.lift(self.start)
        if self.source is not None:
            self._stream = go_on(self.path, start, self.source, self.made + 1)
            return
        self._stream = TrajectoryStream(self.path, start)
        self._stream.append(start.position)

    def append(self, position: NDArray[np.float32]) -> None:
        """Add a frame as the solver runs it [N, D] [m]."""
        assert self._stream is not None
        frame = position[None]
        if self.reduction.description:
            frame = self.reduction.lift(replace(self.start, position=frame)).position
        self._stream.append(frame)
        self._last = frame

    def save(self, make_state: Callable[[], Mapping[str, NDArray[Any]]]) -> None:
        """Save the solver's state at the last frame, if the last time was long ago."""
        if time.perf_counter() - self._saved_at < SAVE_EVERY:
            return
        assert self._stream is not None
        self._stream.flush()  # the frames first: a state without its frames would be useless
        buffer = io.BytesIO()
        np.savez(buffer, **dict(make_state()))  # type: ignore[arg-type]
        write_atomically(self.path.with_name(self.path.name + STATE), buffer.getvalue())
        self._saved_at = time.perf_counter()

    def finish(self, provenance: Mapping[str, object]) -> str:
        """Write how the run was made, give the file its name, and return in words how it ended.

        A run that came to rest is filled up to its time, since nothing moves any more.

        Raises:
            StorageError: the disk refuses; the frames stay.
        """
        assert self._stream is not None
        seconds = time.perf_counter() - self._began
        ending = self.reduction.similarity.ending(provenance)
        self._stream.finish({**self.start.provenance, "wall_seconds": seconds, **ending})
        self.path.with_name(self.path.name + STATE).unlink(missing_ok=True)
        return _ending(self._stream.num_frames, seconds, ending)

    def write(
        self,
        frames: Iterable[tuple[int, NDArray[np.float32], Callable[[], Mapping[str, NDArray[Any]]]]],
        label: str,
        provenance: Mapping[str, object],
    ) -> None:
        """Write all frames of a run as they come, with the solver's state now and then, and print how it ended.

        Args:
            frames: number of a frame, its positions [N, D] [m], and what returns the state there; from the first frame,
                or from that of `saved`, on.
            label: of the bar that shows how far it is.
            provenance: how the run is made.

        Raises:
            StorageError: the disk refuses; the frames stay.
        """
        if self.saved is not None:
            print(f"{label}: goes on after {self.made * self.start.dt:g} s")
        total = self.made + self.num_steps
        self.open()
        try:
            with counting(label, self.start.dt) as show:
                for number, position, make_state in frames:
                    if number > self.made:
                        self.append(position)
                        self.save(make_state)
                        show(number, total)
            print(f"{self.path}: {self.finish(provenance)}", flush=True)
        finally:
            self.close()

    def fill(self, num_frames: int) -> None:
        """Repeat the last frame so many times."""
        assert self._stream is not None
        for _ in range(num_frames):
            self._stream.append(self._last)

    def close(self) -> None:
        """Leave the file growing, with all frames in it; nothing after `finish`."""
        if self._stream is not None:
            self._stream.close()


def is_complete(path: Path, scene: Scene, facts: Mapping[str, object], interval: float) -> bool:
    """Return whether a file holds a whole run of a scene.

    Raises:
        InputError: it holds another run.
    """
    if not path.exists():
        return False
    header = read_header(path)
    same = header.scene == scene and math.isclose(header.dt, interval, rel_tol=1e-6)
    if not same or any(header.provenance.get(key) != value for key, value in facts.items()):
        raise InputError(f"{path}: {REFUSED}")
    return True


def write_whole(path: Path, trajectory: Trajectory, facts: Mapping[str, object]) -> None:
    """Write a whole run into its file, and print how it ended."""
    provenance = {**trajectory.provenance, **facts}
    write_trajectory(path, replace(trajectory, provenance=provenance))
    print(f"{path}: {_ending(trajectory.num_frames, provenance.get('wall_seconds'), provenance)}", flush=True)


def _ending(num_frames: int, seconds: object, provenance: Mapping[str, object]) -> str:
    text = f"{num_frames} frames" + (f" in {seconds:.2f} s" if isinstance(seconds, float) else "")
    rested = provenance.get("at_rest_from")
    text += f", at rest from {rested:.3g} s" if isinstance(rested, float) else ""
    failure = provenance.get("failure")
    return f"{text}; unphysical state: {failure}; run stopped." if failure else text


def _read_state(path: Path) -> dict[str, NDArray[Any]] | None:
    with suppress(OSError, ValueError, KeyError), np.load(path.with_name(path.name + STATE)) as content:
        return {name: content[name] for name in content.files}
    return None
