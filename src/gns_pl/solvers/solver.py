"""What leads from a scene to a trajectory: the type of all solvers.

A solver says what it cannot run, about how much work a run is, and runs it. What that is worth is not known here but
measured (`selection`). One of your own is a class with a name and `run` (docs/extend.md).
"""

from __future__ import annotations

import hashlib
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.errors import InputError
from gns_pl.scene import Scene
from gns_pl.scene.extent import initial_extent, touching_bodies
from gns_pl.solvers.recording import is_complete, write_whole
from gns_pl.solvers.reduction import Reduction
from gns_pl.trajectory import Trajectory


class Solver(ABC):
    """Whatever leads from a scene to a trajectory.

    `name` and `run` are enough; everything else has a default that holds for any solver.

    Attributes:
        name: by which it is asked for, and by which its measured runs are found.
        group: "mpm", "learned", "corrected", "hybrid", "trivial", or another that tables and charts show.
        device: on which it runs, "cpu" or "cuda".
        dtype: of its arithmetic.
        selectable: a tolerance may choose it, once it was measured.
        leaves_out: physics of a scene that it has no variables for, in words; "" where it has all.
    """

    name: str
    group: str = "other"
    device: str = "cpu"
    dtype: str = "float64"
    selectable: bool = True
    leaves_out: str = ""

    @abstractmethod
    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return what becomes of a scene.

        Args:
            scene: what is simulated, over its duration.
            interval: time between frames [s]; None takes the solver's own.
            seed: of the particles' placement.
            monitor: end the run at the first frame that no flow could have, and say so in the provenance
                ("failed_at" [s], "failure").

        Raises:
            InputError: a scene that cannot be run, or a run that became unstable.
        """

    def run_many(
        self,
        scenes: Sequence[Scene],
        *,
        interval: float | None = None,
        seed: int | Sequence[int] = 0,
        monitor: bool = True,
    ) -> list[Trajectory]:
        """Return what becomes of every scene; arguments and errors as those of `run`.

        Several seeds are one for each scene.
        """
        seeds = [seed] * len(scenes) if isinstance(seed, int) else seed
        jobs = zip(scenes, seeds, strict=True)
        return [self.run(scene, interval=interval, seed=number, monitor=monitor) for scene, number in jobs]

    def identity(self) -> str:
        """Return a hash of all that decides what a run gives."""
        return hashed([type(self).__module__, type(self).__qualname__, repr(self), gns_pl.__version__])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return what the provenance of a scene's file says of the solver; a file with other facts is another run's."""
        return {"solver": self.name, "version": gns_pl.__version__}

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return why it cannot run a scene, or None."""
        return None

    def out_of_range_reason(self, scene: Scene) -> str | None:
        """Return what of a scene is outside the range that it was made for, though it would run; or None."""
        return None

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene that is run in the place of another.

        Raises:
            InputError: it cannot be run at all.
        """
        return Reduction(scene, lambda trajectory: trajectory, "")

    def size(self, scene: Scene) -> tuple[int, int] | None:
        """Return the numbers of particles and of steps of a run; None if they are not known before."""
        return None

    def cost(self, scene: Scene) -> float:
        """Return what a run's time is proportional to."""
        size = self.size(scene)
        return 1.0 if size is None else float(math.prod(size))

    def file(self) -> Path | None:
        """Return the file it was read from, if its numbers were trained or fitted."""
        return None

    def on(self, device: str) -> Solver:
        """Return the solver on another device.

        Args:
            device: "cpu", "cuda", or "auto" for where it is measured to run best.

        Raises:
            InputError: a device that is not there, or on which it cannot run.
        """
        if device in ("auto", "cpu"):
            return self
        raise InputError(f"device={device}: {self.name} runs on the CPU alone; choose device=cpu.")

    @contextmanager
    def processes(self) -> Iterator[int]:
        """Share runs out among the processes that torchrun has started, and give this one's number.

        A solver that cannot share a run out leaves it to the first process.
        """
        import os

        yield int(os.environ.get("RANK", "0")) if os.environ.get("WORLD_SIZE", "1") != "1" else 0

    def record(
        self,
        scenes: Sequence[Scene],
        paths: Sequence[Path],
        *,
        interval: float,
        seed: int,
        monitor: bool,
        rank: int = 0,
    ) -> None:
        """Run scenes into files, as far as these are not complete, and print what became of each.

        Args:
            scenes: what is simulated.
            paths: of their files.
            interval: time between frames, of solvers that have none of their own [s].
            seed: as of `run`.
            monitor: likewise.
            rank: of this process, as `processes` gave it.

        Raises:
            InputError: as `run`; or a file of another run in the place of one.
            StorageError: the disk refuses.
        """
        for scene, path in zip(scenes, paths, strict=True) if rank == 0 else ():
            self.record_one(scene, path, interval=interval, seed=seed, monitor=monitor)

    def record_one(self, scene: Scene, path: Path, *, interval: float, seed: int, monitor: bool) -> None:
        """Run a scene into its file; arguments and errors as those of `record`.

        This default runs it whole and writes it at its end; a solver that can go on with a broken run overrides it.
        """
        facts = {**self.facts(scene), "seed": seed}
        if is_complete(path, scene, facts, interval):
            print(f"{path}: already complete")
            return
        write_whole(path, self.run(scene, interval=interval, seed=seed, monitor=monitor), facts)


def characteristic_size(scene: Scene) -> float:
    """Return √(L0 H0), of the extent along x and z of bodies that touch; the largest, where some stand apart [m]."""
    return max(math.sqrt(math.prod(initial_extent(scene.replace(bodies=group)))) for group in touching_bodies(scene))


def hashed(value: Any) -> str:
    """Return a short hash of plain values."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()[:16]
