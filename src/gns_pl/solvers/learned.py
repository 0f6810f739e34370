"""A learned simulator as a solver, and how every run of one is made: the same for files, evaluation, charts and Python.

A run is stabilised, accelerated and watched, ends when nothing moves any more, and says whether its scene is outside
the range of its data (`Policy`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import gns_pl
from gns_pl.errors import InputError
from gns_pl.io import file_sha256
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint, move
from gns_pl.models.shipped import find_checkpoint
from gns_pl.rollout.distributed import processes
from gns_pl.rollout.engine import rollouts
from gns_pl.rollout.failure import Watch
from gns_pl.rollout.policy import Policy
from gns_pl.rollout.stepper import Stepper
from gns_pl.scene import Scene
from gns_pl.scene.extent import num_frames
from gns_pl.solvers.reduction import Reduction, halve_scene
from gns_pl.solvers.similarity import Similarity
from gns_pl.solvers.solver import characteristic_size, hashed
from gns_pl.solvers.trained import TrainedSolver
from gns_pl.solvers.training_range import out_of_range, size_range
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class LearnedSolver(TrainedSolver):
    """A learned simulator.

    Attributes:
        name: of the solver.
        path: of the checkpoint, or the name of one that comes with the package; None for one that is in memory alone.
        policy: how it is run.
        device: "cpu", "cuda", or "auto" for a GPU where there is one.
    """

    name: str
    path: str | Path | None
    policy: Policy = field(default_factory=Policy)
    device: str = "cpu"
    group: str = field(default="learned", init=False)

    @classmethod
    def of(cls, checkpoint: Checkpoint, name: str = "learned", policy: Policy | None = None) -> LearnedSolver:
        """Return the solver of a checkpoint that is in memory, on the device of its weights."""
        solver = cls(name, None, policy or Policy(), str(checkpoint.simulator.device))
        solver.__dict__["checkpoint"] = checkpoint
        return solver

    @cached_property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint, read and moved to its device when first needed."""
        if self.path is None:
            raise InputError(f"{self.name}: has neither a file nor a checkpoint.")
        checkpoint = load_checkpoint(self.path)
        move(checkpoint, self.device, "device")
        return checkpoint

    @cached_property
    def sha256(self) -> str:
        """Hash of the checkpoint's file, computed once: the provenance of every run has it; "" without a file."""
        file = self.file()
        return "" if file is None else file_sha256(file)

    @cached_property
    def stepper(self) -> Stepper:
        """What makes the steps."""
        return self.policy.stepper(self.checkpoint)

    @property
    def dim(self) -> int:  # type: ignore[override]
        """D."""
        return self.checkpoint.simulator.config.dim

    @property
    def spacing(self) -> float:  # type: ignore[override]
        """Of the particles [m]."""
        return self.checkpoint.simulator.config.spacing

    @property
    def interval(self) -> float:  # type: ignore[override]
        """Time of a step [s]."""
        return self.checkpoint.simulator.config.dt

    @property
    def data(self) -> Mapping[str, Any]:  # type: ignore[override]
        """The specification of the data."""
        return self.checkpoint.data

    @property
    def provenance(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Of the training."""
        return self.checkpoint.provenance

    @cached_property
    def _sizes(self) -> tuple[float, float] | None:
        """The least and the largest √(L0 H0) of the data [m]."""
        return size_range(self.data)

    @property
    def knows_surfaces(self) -> bool:
        """Whether it takes obstacles and terrain: a simulator that sees surfaces."""
        return self.checkpoint.simulator.config.sees_surfaces

    def reduced(self, scene: Scene) -> Reduction:
        """Return what is run: the slice for two dimensions, else a half for each mirror plane of a scene.

        A smooth wall stands in for a mirror, so halves are for those that see surfaces and know smooth ones. A scene of
        quite another size than the data's is run at theirs.
        """
        similarity = Similarity.of(characteristic_size(scene), self._sizes)
        model = similarity.model(scene)
        reduction = super().reduced(model)
        if self.knows_surfaces and reduction.scene is model:
            reduction = halve_scene(model)
        return reduction.of_similar(scene, similarity)

    def file(self) -> Path | None:
        """Return the checkpoint's file."""
        return None if self.path is None else find_checkpoint(self.path)

    def identity(self) -> str:
        """Return a hash of the checkpoint and of how it is run."""
        return hashed([self.sha256, gns_pl.__version__, dict(self.policy.stabilise)])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return name, version, the checkpoint and how it is run."""
        file = self.file()
        known = {} if file is None else {"checkpoint": file.name, "checkpoint_sha256": self.sha256}
        return {
            "solver": self.name,
            "version": gns_pl.__version__,
            **known,
            "stabilise": dict(self.policy.stabilise),
            "rest_speed": self.policy.rest_speed,
        }

    def on(self, device: str) -> LearnedSolver:
        """Return the solver on another device; arguments and errors as those of `Solver.on`."""
        return self if device in ("auto", self.device) else replace(self, device=device)

    def run(
        self,
        scene: Scene | Trajectory,
        *,
        interval: float | None = None,
        seed: int = 0,
        monitor: bool = True,
        given: int = 1,
        num_steps: int | None = None,
        on_step: Callable[[int, int], None] | None = None,
    ) -> Trajectory:
        """Return what becomes of a scene, or goes on from the first frames of a trajectory.

        Args:
            scene: a scene, which is filled with particles; or a trajectory, whose first `given` frames are taken.
            interval: as of `Solver.run`.
            seed: likewise.
            monitor: likewise.
            given: frames of a trajectory that are taken as they are.
            num_steps: frames to add; None for the duration of a scene, or to the last frame of a trajectory.
            on_step: called with the number of steps made and their total.

        Raises:
            InputError: as `Solver.run`.
        """
        settings = {"interval": interval, "seed": seed, "monitor": monitor, "given": given, "num_steps": num_steps}
        return self.run_many([scene], **settings, on_step=on_step)[0]  # type: ignore[arg-type]

    def run_many(
        self,
        scenes: Sequence[Scene | Trajectory],
        *,
        interval: float | None = None,
        seed: int | Sequence[int] = 0,
        monitor: bool = True,
        given: int = 1,
        num_steps: int | None = None,
        on_step: Callable[[int, int], None] | None = None,
    ) -> list[Trajectory]:
        """Return what becomes of every scene, all stepped together; arguments and errors as those of `run`.

        Several seeds are one for each scene.
        """
        seeds = [seed] * len(scenes) if isinstance(seed, int) else seed
        reductions = [
            self.reduced(scene.scene if isinstance(scene, Trajectory) else scene) if isinstance(scene, Scene) else None
            for scene in scenes
        ]
        starts = [
            scene if isinstance(scene, Trajectory) else self.start(reduction.scene, number)  # type: ignore[union-attr]
            for scene, reduction, number in zip(scenes, reductions, seeds, strict=True)
        ]
        if interval is not None:
            for scene in scenes:  # refuses one that leaves nothing to show
                num_frames(scene.scene if isinstance(scene, Trajectory) else scene, interval)
        steps = [
            (start.num_frames - given if start.num_frames > given else self.num_steps(start.scene))
            if num_steps is None
            else num_steps
            for start in starts
        ]
        watches = [Watch(start, self.interval, every=self.policy.every) if monitor else None for start in starts]
        trajectories = rollouts(
            self.stepper, starts, steps, given=given, rest=self.policy.rest(), watches=watches, on_step=on_step
        )
        return [
            self._complete(trajectory, reduction, number + given, interval)
            for trajectory, reduction, number in zip(trajectories, reductions, steps, strict=True)
        ]

    def _complete(
        self, trajectory: Trajectory, reduction: Reduction | None, num_frames: int, interval: float | None
    ) -> Trajectory:
        """Return a run with all its frames, also those after it came to rest, of the scene that was asked for."""
        similarity = Similarity() if reduction is None else reduction.similarity
        scene, whole = trajectory.scene, "failed_at" not in trajectory.provenance
        missing = num_frames - trajectory.num_frames if whole else 0
        if missing > 0:
            frames = np.concatenate([trajectory.position, np.repeat(trajectory.position[-1:], missing, axis=0)])
            trajectory = replace(trajectory, position=frames)
        if interval is not None:
            trajectory = trajectory.resampled(interval / similarity.time, scene.duration if whole else None)
        provenance = {**trajectory.provenance, **self.facts(scene)}
        reason = next(out_of_range(scene, self.data), None)
        if reason is not None:
            provenance["out_of_range"] = similarity.told(reason)
        trajectory = replace(trajectory, provenance=provenance)
        return trajectory if reduction is None else reduction.lift(trajectory)

    @contextmanager
    def processes(self) -> Iterator[int]:
        """Share runs out among the processes that torchrun has started."""
        with processes(self.checkpoint.simulator.device) as (rank, _):
            yield rank

    def record(self, scenes: Sequence[Scene], paths: Sequence[Path], **settings: Any) -> None:
        """Run scenes together into files, every frame as soon as it is made; arguments as those of `Solver.record`.

        A file that is there, finished or broken off, is gone on with from its last frame; the result is then the one of
        a single run. Frames are one step apart, whatever `interval` is.

        Raises:
            InputError: as `Solver.record`.
            StorageError: likewise; the frames written stay.
        """
        from gns_pl.solvers.learned_files import record

        record(self, scenes, paths, **settings)
